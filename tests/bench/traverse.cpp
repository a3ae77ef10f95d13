// The traversal kernels of rtrace/traverse.py again in scalar C++, as a peer for their speed: same trees, same rays, same
// arithmetic (build without contraction of a*b+c), same events. Built by tests/bench only; no part of the program.
//
//   g++ -O3 -march=native -ffp-contract=off -shared -fPIC traverse.cpp -o traverse.so

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

namespace {

constexpr double kPad = 1.0 / (1ull << 40);
constexpr double kNarrower = 1.0 - kPad, kWider = 1.0 + kPad;
constexpr int32_t kNoPrim = std::numeric_limits<int32_t>::max();
constexpr uint32_t kRead = 0, kPush = 1, kEnter = 2, kPrefetch = 3, kLeaf = 3;

struct Ray {
    double o[3], d[3], inverse[3];
    int kx, ky, kz;
    double sx, sy, sz;

    Ray(const float* origin, const float* direction) {
        for (int k = 0; k < 3; ++k) {
            o[k] = origin[k];
            d[k] = direction[k];
            inverse[k] = 1.0 / d[k];
        }
        const double ax = std::abs(d[0]), ay = std::abs(d[1]), az = std::abs(d[2]);
        kz = ax >= ay && ax >= az ? 0 : (ay >= az ? 1 : 2);
        kx = (kz + 1) % 3;
        ky = (kx + 1) % 3;
        sx = d[kx] / d[kz];
        sy = d[ky] / d[kz];
        sz = 1.0 / d[kz];
    }

    // Absolute margin of the culling tests: see slack() in rtrace/intersect.py.
    double slack(const float* bounds) const {
        double reach = 0.0, size = 0.0;
        for (int k = 0; k < 3; ++k) {
            reach = std::max({reach, std::abs(bounds[k] - o[k]), std::abs(bounds[3 + k] - o[k])});
            size = std::max(size, std::abs(d[k]));
        }
        return kPad * reach / size;
    }

    // Ray parameter of the hit with the triangle at v, NaN for none (Woop, Benthin, Wald 2013).
    double hit(const float* v) const {
        const double az = v[kz] - o[kz], bz = v[3 + kz] - o[kz], cz = v[6 + kz] - o[kz];
        const double ax = (v[kx] - o[kx]) - sx * az, ay = (v[ky] - o[ky]) - sy * az;
        const double bx = (v[3 + kx] - o[kx]) - sx * bz, by = (v[3 + ky] - o[ky]) - sy * bz;
        const double cx = (v[6 + kx] - o[kx]) - sx * cz, cy = (v[6 + ky] - o[ky]) - sy * cz;
        const double u = cx * by - cy * bx, w = ax * cy - ay * cx, q = bx * ay - by * ax;
        const double low = std::min(std::min(u, w), q), high = std::max(std::max(u, w), q);
        const double det = u + w + q;
        if ((low < 0.0 && high > 0.0) || det == 0.0) return std::numeric_limits<double>::quiet_NaN();
        constexpr double kNoise = kPad / 256;
        const double wide = std::max({std::abs(ax), std::abs(bx), std::abs(cx)});
        const double tall = std::max({std::abs(ay), std::abs(by), std::abs(cy)});
        if (std::abs(det) <= kNoise * wide * tall) {
            const bool beside = std::min({ax, bx, cx}) > kNoise * wide || std::max({ax, bx, cx}) < -kNoise * wide;
            const bool above = std::min({ay, by, cy}) > kNoise * tall || std::max({ay, by, cy}) < -kNoise * tall;
            if (beside || above) return std::numeric_limits<double>::quiet_NaN();
        }
        const double depth = (u * az + w * bz + q * cz) / det;
        return sz * std::max(std::min(depth, std::max({az, bz, cz})), std::min({az, bz, cz}));
    }
};

struct Best {
    double t_min, t;
    int32_t prim = kNoPrim;
    bool any_hit;

    // Test the triangles of a leaf; whether the ray is done.
    bool leaf(const Ray& ray, const int32_t* prims, uint32_t n, const float* tri) {
        for (uint32_t i = 0; i < n; ++i) {
            const double h = ray.hit(tri + 9 * static_cast<int64_t>(prims[i]));
            if (h >= t_min && (h < t || (h == t && prims[i] < prim))) {
                t = h;
                prim = prims[i];
                if (any_hit) return true;
            }
        }
        return false;
    }
};

// Events go to `events` if it is not null; the caller provides room.
struct Trace {
    uint32_t* events;
    int64_t n = 0;
    void add(uint32_t node, uint32_t kind) {
        if (events) events[n++] = node << 2 | kind;
    }
};

void finish(const Best& best, int32_t* prim, double* t) {
    *prim = best.prim == kNoPrim ? -1 : best.prim;
    *t = best.prim == kNoPrim ? std::numeric_limits<double>::infinity() : best.t;
}

}  // namespace

extern "C" int64_t trace_bvh(const float* nodes, const uint32_t* meta, const int32_t* prims, const float* tri, int max_level,
                             const float* origin, const float* direction, const double* t_min, const double* t_max,
                             int64_t n_rays, int any_hit, int32_t* prim, double* t, uint32_t* count, uint32_t* events) {
    std::vector<uint32_t> stack(max_level + 1);
    Trace trace{events};
    for (int64_t i = 0; i < n_rays; ++i) {
        const Ray ray(origin + 3 * i, direction + 3 * i);
        Best best{t_min[i], t_max[i], kNoPrim, any_hit != 0};
        int near[3], far[3];
        uint32_t backwards = 0;
        for (int k = 0; k < 3; ++k) {
            const bool negative = ray.inverse[k] < 0.0;
            near[k] = negative ? k + 3 : k;
            far[k] = negative ? k : k + 3;
            backwards |= static_cast<uint32_t>(negative) << k;
        }
        const int64_t start = trace.n;
        const double margin = ray.slack(nodes);
        int sp = 0, pp = 0;
        uint32_t node = 0;
        for (;;) {
            const float* box = nodes + 8 * static_cast<int64_t>(node);
            double t0 = best.t_min, t1 = best.t;
            for (int k = 0; k < 3; ++k) {
                const double a = (box[near[k]] - ray.o[k]) * ray.inverse[k], z = (box[far[k]] - ray.o[k]) * ray.inverse[k];
                t0 = a > t0 ? a : t0;
                t1 = z < t1 ? z : t1;
            }
            if (t0 * kNarrower - margin <= t1 * kWider) {
                const uint32_t child = meta[8 * static_cast<int64_t>(node) + 6], m = meta[8 * static_cast<int64_t>(node) + 7];
                if ((m & 3) != kLeaf) {
                    trace.add(node, kPush);
                    const uint32_t upper_first = backwards >> m & 1;
                    stack[sp++] = child + 1 - upper_first;
                    pp = sp;
                    node = child + upper_first;
                    continue;
                }
                trace.add(node, kEnter);
                if (events)
                    while (pp > 0) trace.add(stack[--pp], kPrefetch);
                if (best.leaf(ray, prims + child, m >> 2, tri)) break;
            } else {
                trace.add(node, kRead);
            }
            if (sp == 0) break;
            node = stack[--sp];
            pp = std::min(pp, sp);
        }
        count[i] = static_cast<uint32_t>(trace.n - start);
        finish(best, prim + i, t + i);
    }
    return trace.n;
}

extern "C" int64_t trace_kdtree(const float* nodes, const uint32_t* meta, const int32_t* prims, const float* tri,
                                const float* bounds, int max_level, const float* origin, const float* direction,
                                const double* t_min, const double* t_max, int64_t n_rays, int any_hit, int32_t* prim,
                                double* t, uint32_t* count, uint32_t* events) {
    struct Entry {
        double t0, t1;
        uint32_t node;
    };
    std::vector<Entry> stack(max_level + 1);
    Trace trace{events};
    for (int64_t i = 0; i < n_rays; ++i) {
        const Ray ray(origin + 3 * i, direction + 3 * i);
        Best best{t_min[i], t_max[i], kNoPrim, any_hit != 0};
        const int64_t start = trace.n;
        double t0 = best.t_min, t1 = best.t;
        for (int k = 0; k < 3; ++k) {
            const int near = ray.inverse[k] >= 0.0 ? k : k + 3, far = ray.inverse[k] >= 0.0 ? k + 3 : k;
            const double a = (bounds[near] - ray.o[k]) * ray.inverse[k], z = (bounds[far] - ray.o[k]) * ray.inverse[k];
            t0 = a > t0 ? a : t0;
            t1 = z < t1 ? z : t1;
        }
        const double margin = ray.slack(bounds);
        t0 = t0 * kNarrower - margin;
        t1 = t1 * kWider + margin;
        int sp = 0, pp = 0;
        uint32_t node = 0;
        while (t0 <= t1) {
            const uint32_t m = meta[2 * static_cast<int64_t>(node) + 1];
            const uint32_t axis = m & 3;
            if (axis != kLeaf) {
                const double inverse = ray.inverse[axis];
                const double distance = nodes[2 * static_cast<int64_t>(node)] - ray.o[axis];
                const double a = distance * inverse * kNarrower, z = distance * inverse * kWider;
                double low = std::min(a, z) - margin, high = std::max(a, z) + margin;
                uint32_t upper_first = inverse < 0.0;
                bool visits_near = high >= t0, visits_far = low <= t1;
                if (std::isinf(inverse)) {
                    upper_first = distance <= 0.0;
                    visits_near = true;
                    visits_far = distance == 0.0;
                    low = t0;
                    high = t1;
                }
                const uint32_t near = (m >> 2) + upper_first, far = (m >> 2) + 1 - upper_first;
                if (visits_far && visits_near) {
                    trace.add(node, kPush);
                    stack[sp++] = {std::max(low, t0), t1, far};
                    pp = sp;
                    t1 = std::min(high, t1);
                    node = near;
                } else {
                    trace.add(node, kRead);
                    node = visits_near ? near : far;
                }
                continue;
            }
            trace.add(node, kEnter);
            if (events && m >> 2)
                while (pp > 0) trace.add(stack[--pp].node, kPrefetch);
            if (best.leaf(ray, prims + meta[2 * static_cast<int64_t>(node)], m >> 2, tri)) break;
            while (sp > 0 && stack[sp - 1].t0 > best.t) --sp;
            if (sp == 0) break;
            --sp;
            pp = std::min(pp, sp);
            node = stack[sp].node;
            t0 = stack[sp].t0;
            t1 = stack[sp].t1;
        }
        count[i] = static_cast<uint32_t>(trace.n - start);
        finish(best, prim + i, t + i);
    }
    return trace.n;
}

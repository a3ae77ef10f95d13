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

constexpr double kPad = 0x1p-44, kOriginPad = 0x1p-50, kLeastPad = 1e-100, kThin = 0x1p-6;
constexpr int32_t kNoPrim = std::numeric_limits<int32_t>::max();
constexpr uint32_t kRead = 0, kPush = 1, kEnter = 2, kPrefetch = 3, kLeaf = 3;

// a * b - product, exactly (Dekker 1971).
double lost_by(double a, double b, double product) {
    constexpr double kSplitter = 0x1p27 + 1.0;
    double t = kSplitter * a;
    const double a_high = t - (t - a), a_low = a - a_high;
    t = kSplitter * b;
    const double b_high = t - (t - b), b_low = b - b_high;
    return ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low;
}

double difference(double a, double b, double c, double d) {
    const double p = a * b, q = c * d;
    return (p - q) + (lost_by(a, b, p) - lost_by(c, d, q));
}

struct Ray {
    double o[3], d[3], inverse[3], near[3], far[3];
    int kx, ky, kz;
    double sx, sy, sz;

    Ray(const float* origin, const float* direction, const float* core) {
        double reach[3];
        for (int k = 0; k < 3; ++k) {
            o[k] = origin[k];
            d[k] = direction[k];
            inverse[k] = d[k] != 0.0 ? 1.0 / d[k] : std::numeric_limits<double>::max();
            reach[k] = std::max(std::abs(core[k] - o[k]), std::abs(core[3 + k] - o[k]));
        }
        const double ax = std::abs(d[0]), ay = std::abs(d[1]), az = std::abs(d[2]);
        kz = ax >= ay && ax >= az ? 0 : (ay >= az ? 1 : 2);
        kx = (kz + 1) % 3;
        ky = (kx + 1) % 3;
        sz = inverse[kz];
        sx = d[kx] * sz;
        sy = d[ky] * sz;
        // Margins of the culling tests: see rtrace/intersect.py.
        const double along = reach[kz] * std::abs(sz);
        for (int k = 0; k < 3; ++k) {
            double pad = kPad * (reach[k] + along * std::abs(d[k])) + kOriginPad * std::abs(o[k]) + kLeastPad;
            if (inverse[k] < 0.0) pad = -pad;
            near[k] = o[k] + pad;
            far[k] = o[k] - pad;
        }
    }

    // Where the ray ends: NaN, which no t reaches, if it is none.
    double end(double t_max) const {
        const double total = o[0] + o[1] + o[2] + d[0] + d[1] + d[2];
        const bool is_ray = total - total == 0.0 && (d[0] != 0.0 || d[1] != 0.0 || d[2] != 0.0);
        return is_ray ? t_max : std::numeric_limits<double>::quiet_NaN();
    }

    // Ray parameter of the hit with the triangle at v, NaN for none (Woop, Benthin, Wald 2013).
    double hit(const float* v) const {
        constexpr double kNone = std::numeric_limits<double>::quiet_NaN();
        const double az = v[kz] - o[kz], bz = v[3 + kz] - o[kz], cz = v[6 + kz] - o[kz];
        const double ax = (v[kx] - o[kx]) - sx * az, ay = (v[ky] - o[ky]) - sy * az;
        const double bx = (v[3 + kx] - o[kx]) - sx * bz, by = (v[3 + ky] - o[ky]) - sy * bz;
        const double cx = (v[6 + kx] - o[kx]) - sx * cz, cy = (v[6 + ky] - o[ky]) - sy * cz;
        double u = cx * by - cy * bx, w = ax * cy - ay * cx, q = bx * ay - by * ax;
        if (std::min(std::min(u, w), q) < 0.0 && std::max(std::max(u, w), q) > 0.0) return kNone;
        double det = u + w + q;
        const double size = std::abs(cx * by) + std::abs(cy * bx) + std::abs(ax * cy) + std::abs(ay * cx) +
                            std::abs(bx * ay) + std::abs(by * ax);
        if (std::abs(det) <= kThin * size || u == 0.0 || w == 0.0 || q == 0.0) {
            u = difference(cx, by, cy, bx);
            w = difference(ax, cy, ay, cx);
            q = difference(bx, ay, by, ax);
            det = u + w + q;
        }
        if ((std::min({u, w, q}) < 0.0 && std::max({u, w, q}) > 0.0) || det == 0.0) return kNone;
        return (u * az + w * bz + q * cz) / det * sz;
    }
};

struct Best {
    double t_min, t;
    int32_t prim = kNoPrim;
    bool any_hit;

    // Test the triangles of a leaf; whether the ray is done.
    bool leaf(const Ray& ray, const int32_t* prims, uint32_t n, const float* corners) {
        for (uint32_t i = 0; i < n; ++i) {
            const double h = ray.hit(corners + 9 * i);
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

extern "C" int64_t trace_bvh(const float* nodes, const uint32_t* meta, const int32_t* prims, const float* corners,
                             const float* core, int max_level, const float* origin, const float* direction, const double* t_min, const double* t_max,
                             int64_t n_rays, int any_hit, int32_t* prim, double* t, uint32_t* count, uint32_t* events) {
    std::vector<uint32_t> stack(max_level + 1);
    Trace trace{events};
    for (int64_t i = 0; i < n_rays; ++i) {
        const Ray ray(origin + 3 * i, direction + 3 * i, core);
        Best best{t_min[i], ray.end(t_max[i]), kNoPrim, any_hit != 0};
        int near[3], far[3];
        uint32_t backwards = 0;
        for (int k = 0; k < 3; ++k) {
            const bool negative = ray.inverse[k] < 0.0;
            near[k] = negative ? k + 3 : k;
            far[k] = negative ? k : k + 3;
            backwards |= static_cast<uint32_t>(negative) << k;
        }
        const int64_t start = trace.n;
        int sp = 0, pp = 0;
        uint32_t node = 0;
        for (;;) {
            const float* box = nodes + 8 * static_cast<int64_t>(node);
            double t0 = best.t_min, t1 = best.t;
            for (int k = 0; k < 3; ++k) {
                const double a = (box[near[k]] - ray.near[k]) * ray.inverse[k];
                const double z = (box[far[k]] - ray.far[k]) * ray.inverse[k];
                t0 = a > t0 ? a : t0;
                t1 = z < t1 ? z : t1;
            }
            if (t0 <= t1) {
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
                if (best.leaf(ray, prims + child, m >> 2, corners + 9 * static_cast<int64_t>(child))) break;
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

extern "C" int64_t trace_kdtree(const float* nodes, const uint32_t* meta, const int32_t* prims, const float* corners,
                                const float* core, const float* bounds, int max_level, const float* origin, const float* direction,
                                const double* t_min, const double* t_max, int64_t n_rays, int any_hit, int32_t* prim,
                                double* t, uint32_t* count, uint32_t* events) {
    struct Entry {
        double t0, t1;
        uint32_t node;
    };
    std::vector<Entry> stack(max_level + 1);
    Trace trace{events};
    for (int64_t i = 0; i < n_rays; ++i) {
        const Ray ray(origin + 3 * i, direction + 3 * i, core);
        Best best{t_min[i], ray.end(t_max[i]), kNoPrim, any_hit != 0};
        const int64_t start = trace.n;
        double t0 = best.t_min, t1 = best.t;
        for (int k = 0; k < 3; ++k) {
            const int near = ray.inverse[k] < 0.0 ? k + 3 : k, far = ray.inverse[k] < 0.0 ? k : k + 3;
            const double a = (bounds[near] - ray.near[k]) * ray.inverse[k];
            const double z = (bounds[far] - ray.far[k]) * ray.inverse[k];
            t0 = a > t0 ? a : t0;
            t1 = z < t1 ? z : t1;
        }
        int sp = 0, pp = 0;
        uint32_t node = 0;
        while (t0 <= t1) {
            const uint32_t m = meta[2 * static_cast<int64_t>(node) + 1];
            const uint32_t axis = m & 3;
            if (axis != kLeaf) {
                const double split = nodes[2 * static_cast<int64_t>(node)], inverse = ray.inverse[axis];
                const double low = (split - ray.near[axis]) * inverse, high = (split - ray.far[axis]) * inverse;
                const uint32_t upper_first = inverse < 0.0;
                const bool visits_near = high >= t0, visits_far = low <= t1;
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
            const int64_t first = meta[2 * static_cast<int64_t>(node)];
            if (best.leaf(ray, prims + first, m >> 2, corners + 9 * first)) break;
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

// Two ways of tracing several rays at once, tried against one ray at a time: packets of four rays (AVX), and several rays in
// flight, one visit each in turn. They find the hits and write the events of traverse.cpp; docs/performance.md says how fast.
//
//   g++ -O3 -march=native -ffp-contract=off -shared -fPIC several_rays.cpp -o several_rays.so

#include <cstring>
#include <memory>

#include "traverse.cpp"

namespace {

constexpr int64_t kRoom = 1 << 16;  // events of one ray

// Events of each ray in a slice of its own, which one at a time is copied behind those of the rays before it.
struct Slices {
    std::unique_ptr<uint32_t[]> room;
    explicit Slices(int n) : room(new uint32_t[n * kRoom]) {}
    uint32_t* of(int i) { return room.get() + i * kRoom; }
};

}  // namespace

#ifdef __AVX__  // a processor without it has rays in flight only
#include <immintrin.h>

namespace {

typedef double Four __attribute__((vector_size(32)));
typedef int64_t Mask __attribute__((vector_size(32)));

unsigned bits(Mask m) { return _mm256_movemask_pd(reinterpret_cast<__m256d>(m)); }
Mask lanes(unsigned m) { return Mask{m & 1, m >> 1 & 1, m >> 2 & 1, m >> 3 & 1} != 0; }
Four all(double x) { return Four{x, x, x, x}; }
Four least(Four a, Four b) { return a < b ? a : b; }
Four most(Four a, Four b) { return a > b ? a : b; }
Four size(Four a) { return a < 0.0 ? -a : a; }
bool has(unsigned mask, int lane) { return mask >> lane & 1; }

// Four rays whose directions have the same signs and the same largest axis, so that they visit in the same order.
struct Packet {
    std::vector<Ray> rays;
    Four o[3], inverse[3], near[3], far[3], sx, sy, sz, t_min, t;
    Mask prim = Mask{kNoPrim, kNoPrim, kNoPrim, kNoPrim};
    unsigned signs = 0, alive = 15;
    bool any_hit, fits;
    uint32_t *events[4], n_pushed[4] = {0, 0, 0, 0};  // a ray's events, and its pre-fetch pointer

    Packet(const float* origin, const float* direction, const float* core, const double* from, const double* to, int64_t n,
           bool any_hit_, Slices& slices)
        : any_hit(any_hit_), fits(n >= 4) {
        for (int i = 0; i < 4 && fits; ++i) {
            rays.emplace_back(origin + 3 * i, direction + 3 * i, core);
            unsigned s = 0;
            for (int k = 0; k < 3; ++k) s |= static_cast<unsigned>(rays[i].inverse[k] < 0.0) << k;
            fits = i == 0 || (s == signs && rays[i].kz == rays[0].kz);
            signs = s;
            for (int k = 0; k < 3; ++k) {
                o[k][i] = rays[i].o[k];
                inverse[k][i] = rays[i].inverse[k];
                near[k][i] = rays[i].near[k];
                far[k][i] = rays[i].far[k];
            }
            sx[i] = rays[i].sx, sy[i] = rays[i].sy, sz[i] = rays[i].sz, t_min[i] = from[i], t[i] = to[i];
            events[i] = slices.of(i);
        }
    }

    // Part of [t0, t1] between the near and far planes of a box.
    void clip(const float* box, Four& t0, Four& t1) const {
        for (int k = 0; k < 3; ++k) {
            const int back = has(signs, k) ? 3 : 0;
            t0 = most((all(box[k + back]) - near[k]) * inverse[k], t0);
            t1 = least((all(box[k + 3 - back]) - far[k]) * inverse[k], t1);
        }
    }

    // An event of every ray in `mask`, of kind `kind` for those in `which` and kRead for the others.
    void add(unsigned mask, uint32_t node, unsigned which, uint32_t kind) {
        for (int i = 0; i < 4; ++i) {
            *events[i] = node << 2 | (has(which, i) ? kind : kRead);
            events[i] += has(mask, i);
        }
    }

    void pushed(unsigned mask, uint32_t sp) {
        for (int i = 0; i < 4; ++i) n_pushed[i] = has(mask, i) ? sp : n_pushed[i];
    }

    // What each ray in `mask` requests: the entries of the common stack that are its own.
    template <class Entry>
    void request(unsigned mask, const Entry* stack, uint32_t sp) {
        for (int i = 0; i < 4; ++i) {
            if (!has(mask, i)) continue;
            for (uint32_t j = std::min(n_pushed[i], sp); j-- > 0;) {
                *events[i] = stack[j].node << 2 | kPrefetch;
                events[i] += has(stack[j].mask, i);
            }
            n_pushed[i] = 0;
        }
    }

    // Test the triangles of a leaf for the rays in `mask`.
    void leaf(unsigned mask, const int32_t* prims, uint32_t n, const float* v) {
        const int kx = rays[0].kx, ky = rays[0].ky, kz = rays[0].kz;
        for (uint32_t i = 0; i < n && mask; ++i, v += 9) {
            const Four az = all(v[kz]) - o[kz], bz = all(v[3 + kz]) - o[kz], cz = all(v[6 + kz]) - o[kz];
            const Four ax = (all(v[kx]) - o[kx]) - sx * az, ay = (all(v[ky]) - o[ky]) - sy * az;
            const Four bx = (all(v[3 + kx]) - o[kx]) - sx * bz, by = (all(v[3 + ky]) - o[ky]) - sy * bz;
            const Four cx = (all(v[6 + kx]) - o[kx]) - sx * cz, cy = (all(v[6 + ky]) - o[ky]) - sy * cz;
            const Four u = cx * by - cy * bx, w = ax * cy - ay * cx, q = bx * ay - by * ax;
            const unsigned inside = mask & ~bits((least(least(u, w), q) < 0.0) & (most(most(u, w), q) > 0.0));
            if (!inside) continue;
            const Four det = u + w + q;
            const Four sum = size(cx * by) + size(cy * bx) + size(ax * cy) + size(ay * cx) + size(bx * ay) + size(by * ax);
            Four hit = (u * az + w * bz + q * cz) / det * sz;
            const unsigned thin = inside & bits((size(det) <= kThin * sum) | (u == 0.0) | (w == 0.0) | (q == 0.0));
            for (int k = 0; k < 4 && thin; ++k)
                if (has(thin, k)) hit[k] = rays[k].hit(v);
            const Mask number = Mask{prims[i], prims[i], prims[i], prims[i]};
            const Mask better = (hit >= t_min) & ((hit < t) | ((hit == t) & (number < prim))) & lanes(inside);
            t = better ? hit : t;
            prim = better ? number : prim;
            if (any_hit) mask &= ~bits(better);
        }
        if (any_hit) alive &= bits(prim == static_cast<int64_t>(kNoPrim));
    }

    // Hand over the hits and, in ray order, the events; return the number of events.
    int64_t finish(int32_t* prims, double* ts, uint32_t* count, uint32_t* out, Slices& slices) const {
        int64_t total = 0;
        for (int i = 0; i < 4; ++i) {
            Best best{t_min[i], t[i], static_cast<int32_t>(prim[i]), any_hit};
            ::finish(best, prims + i, ts + i);
            count[i] = static_cast<uint32_t>(events[i] - slices.of(i));
            std::memcpy(out + total, slices.of(i), 4 * count[i]);
            total += count[i];
        }
        return total;
    }
};

}  // namespace

extern "C" int64_t packets_bvh(const float* nodes, const uint32_t* meta, const int32_t* prims, const float* corners,
                               const float* core, int max_level, const float* origin, const float* direction, const double* t_min, const double* t_max,
                               int64_t n_rays, int any_hit, int32_t* prim, double* t, uint32_t* count, uint32_t* events) {
    struct Entry {
        uint32_t node, mask;
    };
    std::vector<Entry> stack(max_level + 1);
    Slices slices(4);
    int64_t total = 0;
    for (int64_t i = 0; i < n_rays; i += 4) {
        Packet p(origin + 3 * i, direction + 3 * i, core, t_min + i, t_max + i, n_rays - i, any_hit != 0, slices);
        if (!p.fits) {
            total += trace_bvh(nodes, meta, prims, corners, core, max_level, origin + 3 * i, direction + 3 * i, t_min + i, t_max + i,
                               std::min<int64_t>(4, n_rays - i), any_hit, prim + i, t + i, count + i, events + total);
            continue;
        }
        uint32_t sp = 0, node = 0;
        unsigned mask = 15;
        while (mask) {
            const int64_t at = 8 * static_cast<int64_t>(node);
            Four t0 = p.t_min, t1 = p.t;
            p.clip(nodes + at, t0, t1);
            const unsigned inside = mask & bits(t0 <= t1);
            const uint32_t child = meta[at + 6], m = meta[at + 7];
            if (inside && (m & 3) != kLeaf) {
                const uint32_t upper_first = p.signs >> m & 1;
                stack[sp++] = {child + 1 - upper_first, inside};
                p.add(mask, node, inside, kPush);
                p.pushed(inside, sp);
                node = child + upper_first;
                mask = inside;
                continue;
            }
            p.add(mask & ~inside, node, 0, kRead);
            if (inside) {
                p.add(inside, node, inside, kEnter);
                p.request(inside, stack.data(), sp);
                p.leaf(inside, prims + child, m >> 2, corners + 9 * static_cast<int64_t>(child));
            }
            for (mask = 0; sp && !mask; --sp) node = stack[sp - 1].node, mask = stack[sp - 1].mask & p.alive;
        }
        total += p.finish(prim + i, t + i, count + i, events + total, slices);
    }
    return total;
}

extern "C" int64_t packets_kdtree(const float* nodes, const uint32_t* meta, const int32_t* prims, const float* corners,
                                  const float* core, const float* bounds, int max_level, const float* origin, const float* direction,
                                  const double* t_min, const double* t_max, int64_t n_rays, int any_hit, int32_t* prim,
                                  double* t, uint32_t* count, uint32_t* events) {
    struct Entry {
        Four t0, t1;
        uint32_t node, mask;
    };
    std::vector<Entry> stack(max_level + 1);
    Slices slices(4);
    int64_t total = 0;
    for (int64_t i = 0; i < n_rays; i += 4) {
        Packet p(origin + 3 * i, direction + 3 * i, core, t_min + i, t_max + i, n_rays - i, any_hit != 0, slices);
        if (!p.fits) {
            total += trace_kdtree(nodes, meta, prims, corners, core, bounds, max_level, origin + 3 * i, direction + 3 * i, t_min + i,
                                  t_max + i, std::min<int64_t>(4, n_rays - i), any_hit, prim + i, t + i, count + i,
                                  events + total);
            continue;
        }
        Four t0 = p.t_min, t1 = p.t;
        p.clip(bounds, t0, t1);
        uint32_t sp = 0, node = 0;
        unsigned mask = bits(t0 <= t1);
        while (mask) {
            const uint32_t m = meta[2 * static_cast<int64_t>(node) + 1], axis = m & 3, n = m >> 2;
            if (axis != kLeaf) {
                const Four split = all(nodes[2 * static_cast<int64_t>(node)]);
                const Four low = (split - p.near[axis]) * p.inverse[axis], high = (split - p.far[axis]) * p.inverse[axis];
                const uint32_t upper_first = p.signs >> axis & 1;
                const unsigned near = mask & bits(high >= t0), far = mask & (bits(low <= t1) | ~near), both = near & far;
                p.add(mask, node, both, kPush);
                if (near && far) {  // for a ray that visits the far child alone this is not a push: it only waits its turn
                    stack[sp++] = {lanes(both) ? most(low, t0) : t0, t1, n + 1 - upper_first, far};
                    p.pushed(both, sp);
                    t1 = lanes(both) ? least(high, t1) : t1;
                }
                node = near ? n + upper_first : n + 1 - upper_first;
                mask = near ? near : far;
                continue;
            }
            p.add(mask, node, mask, kEnter);
            if (n) {
                const int64_t first = meta[2 * static_cast<int64_t>(node)];
                p.request(mask, stack.data(), sp);
                p.leaf(mask, prims + first, n, corners + 9 * first);
            }
            for (mask = 0; sp && !mask; --sp) {
                const Entry& top = stack[sp - 1];
                node = top.node, t0 = top.t0, t1 = top.t1;
                mask = top.mask & p.alive & ~bits(t0 > p.t);
            }
        }
        total += p.finish(prim + i, t + i, count + i, events + total, slices);
    }
    return total;
}

#endif  // __AVX__

// The BVH kernel with four rays in flight. The node that a ray visits next is asked for while the others take their turns.
extern "C" int64_t in_flight_bvh(const float* nodes, const uint32_t* meta, const int32_t* prims, const float* corners,
                                 const float* core, int max_level, const float* origin, const float* direction, const double* t_min,
                                 const double* t_max, int64_t n_rays, int any_hit, int32_t* prim, double* t, uint32_t* count,
                                 uint32_t* events) {
    constexpr int kInFlight = 4;
    struct Flight {
        int64_t i;
        Ray ray;
        Best best;
        uint32_t signs, node, *stack, *end;
        int sp, pp;
    };
    std::vector<uint32_t> stacks(kInFlight * (max_level + 1)), done;
    std::vector<int64_t> where(n_rays);
    std::vector<Flight> flights;
    Slices slices(kInFlight);
    int64_t next = 0;
    const auto start = [&](int slot) {
        const int64_t i = next++;
        Flight f{i, Ray(origin + 3 * i, direction + 3 * i, core), Best{t_min[i], t_max[i], kNoPrim, any_hit != 0}, 0, 0,
                 stacks.data() + slot * (max_level + 1), slices.of(slot), 0, 0};
        for (int k = 0; k < 3; ++k) f.signs |= static_cast<uint32_t>(f.ray.inverse[k] < 0.0) << k;
        return f;
    };
    while (next < std::min<int64_t>(kInFlight, n_rays)) flights.push_back(start(static_cast<int>(next)));
    for (int64_t n_left = n_rays; n_left > 0;) {
        for (int slot = 0; slot < static_cast<int>(flights.size()); ++slot) {
            Flight& f = flights[slot];
            if (f.i < 0) continue;
            const int64_t at = 8 * static_cast<int64_t>(f.node);
            double t0 = f.best.t_min, t1 = f.best.t;
            for (int k = 0; k < 3; ++k) {
                const int back = f.signs >> k & 1 ? 3 : 0;
                const double a = (nodes[at + k + back] - f.ray.near[k]) * f.ray.inverse[k];
                const double z = (nodes[at + k + 3 - back] - f.ray.far[k]) * f.ray.inverse[k];
                t0 = a > t0 ? a : t0;
                t1 = z < t1 ? z : t1;
            }
            const uint32_t child = meta[at + 6], m = meta[at + 7];
            bool is_done = false;
            if (t0 <= t1 && (m & 3) != kLeaf) {
                *f.end++ = f.node << 2 | kPush;
                const uint32_t upper_first = f.signs >> m & 1;
                f.stack[f.sp++] = child + 1 - upper_first;
                f.pp = f.sp;
                f.node = child + upper_first;
            } else {
                *f.end++ = f.node << 2 | (t0 <= t1 ? kEnter : kRead);
                if (t0 <= t1) {
                    while (f.pp > 0) *f.end++ = f.stack[--f.pp] << 2 | kPrefetch;
                    is_done = f.best.leaf(f.ray, prims + child, m >> 2, corners + 9 * static_cast<int64_t>(child));
                }
                is_done |= f.sp == 0;
                if (!is_done) f.node = f.stack[--f.sp];
                f.pp = std::min(f.pp, f.sp);
            }
            __builtin_prefetch(nodes + 8 * static_cast<int64_t>(f.node));
            if (!is_done) continue;
            finish(f.best, prim + f.i, t + f.i);
            where[f.i] = static_cast<int64_t>(done.size());
            count[f.i] = static_cast<uint32_t>(f.end - slices.of(slot));
            done.insert(done.end(), slices.of(slot), f.end);
            --n_left;
            if (next < n_rays)
                f = start(slot);
            else
                f.i = -1;
        }
    }
    int64_t total = 0;
    for (int64_t i = 0; i < n_rays; total += count[i++]) std::memcpy(events + total, done.data() + where[i], 4 * count[i]);
    return total;
}

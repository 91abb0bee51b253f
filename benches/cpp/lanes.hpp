// Number types of the C++ extension: one double, or a vector of eight, which the compiler splits into the CPU's
// registers.
#pragma once
#include <cmath>
#include <cstdint>
#include <cstring>

namespace peer {

typedef double Eight __attribute__((vector_size(64)));
typedef std::int64_t Whole __attribute__((vector_size(64)));

inline double zero(double) { return 0.0; }
inline Eight zero(Eight) { return Eight{}; }

// Picks a where the bits of `mask` are set, else b.
inline double pick(std::int64_t mask, double a, double b) { return mask ? a : b; }
inline Eight pick(Whole mask, Eight a, Eight b) { return mask ? a : b; }
inline std::int64_t bits(double x) {
    std::int64_t out;
    std::memcpy(&out, &x, sizeof out);
    return out;
}
inline Whole bits(Eight x) { return (Whole)x; }

// Sine and cosine by reduction to a quarter turn and Taylor series, without branches or calls; |x| < 1e6.
template <class T> inline void sin_cos(T x, T &sine, T &cosine) {
    const T none = zero(x), round = none + 6755399441055744.0;
    const T sum = x * 0.6366197723675814 + round, turns = sum - round;
    T r = x - turns * 1.5707963267341256;
    r = r - turns * 6.077100506303966e-11;
    r = r - turns * 2.0222662487959506e-21;
    const T r2 = r * r;
    T s = none - 1.0 / 1307674368000.0;
    s = s * r2 + 1.0 / 6227020800.0;
    s = s * r2 - 1.0 / 39916800.0;
    s = s * r2 + 1.0 / 362880.0;
    s = s * r2 - 1.0 / 5040.0;
    s = s * r2 + 1.0 / 120.0;
    s = s * r2 - 1.0 / 6.0;
    s = r + r * r2 * s;
    T c = none + 1.0 / 20922789888000.0;
    c = c * r2 - 1.0 / 87178291200.0;
    c = c * r2 + 1.0 / 479001600.0;
    c = c * r2 - 1.0 / 3628800.0;
    c = c * r2 + 1.0 / 40320.0;
    c = c * r2 - 1.0 / 720.0;
    c = c * r2 + 1.0 / 24.0;
    c = 1.0 - 0.5 * r2 + r2 * r2 * c;
    const auto quarter = bits(sum);
    const auto odd = (quarter & 1) != 0, lower = (quarter & 2) != 0, left = ((quarter + 1) & 2) != 0;
    const T a = pick(odd, c, s), b = pick(odd, s, c);
    sine = pick(lower, -a, a);
    cosine = pick(left, -b, b);
}

} // namespace peer

// The arm and the law with every size fixed at compile time: what a C++ programmer would write for this arm alone.
#pragma once
#include "lanes.hpp"

namespace peer {

constexpr int N = 7;

// Everything that does not change from call to call; filled from Python.
struct Constants {
    double links[N + 1][4][4];
    double middle[N], weights[N], rest[N];
    double d_minus[6], d_plus[6], soft[6], firm[6], keep[6]; // keep: 1 − η on axes that yield, 1 elsewhere
    double damping, gain, horizon, alpha, null_budget;
};

template <class T> struct Motion {
    T R[3][3], p[3], J[6][N];
};

// Pose and geometric Jacobian of the tool, base axes.
template <class T> inline void kinematics(const Constants &k, const T *q, Motion<T> &out) {
    T R[3][3], p[3], axis[N][3], at[N][3];
    const T none = zero(q[0]);
    for (int r = 0; r < 3; ++r) {
        p[r] = none + k.links[0][r][3];
        for (int c = 0; c < 3; ++c) R[r][c] = none + k.links[0][r][c];
    }
#pragma GCC unroll 8
    for (int i = 0; i < N; ++i) {
        T s, c;
        sin_cos(q[i], s, c);
        const auto &next = k.links[i + 1];
        for (int r = 0; r < 3; ++r) {
            axis[i][r] = R[r][2];
            at[i][r] = p[r];
            const T x = R[r][0] * c + R[r][1] * s, y = R[r][1] * c - R[r][0] * s, z = R[r][2];
            p[r] += x * next[0][3] + y * next[1][3] + z * next[2][3];
            for (int j = 0; j < 3; ++j) R[r][j] = x * next[0][j] + y * next[1][j] + z * next[2][j];
        }
    }
    for (int i = 0; i < N; ++i) {
        const T x = p[0] - at[i][0], y = p[1] - at[i][1], z = p[2] - at[i][2];
        out.J[0][i] = axis[i][1] * z - axis[i][2] * y;
        out.J[1][i] = axis[i][2] * x - axis[i][0] * z;
        out.J[2][i] = axis[i][0] * y - axis[i][1] * x;
        for (int r = 0; r < 3; ++r) out.J[3 + r][i] = axis[i][r];
    }
    std::memcpy(out.R, R, sizeof R);
    std::memcpy(out.p, p, sizeof p);
}

// Deviation: difference of positions, and the rotation vector of R_d Rᵀ.
inline void deviation(const Motion<double> &m, const double *target, double *e) {
    double turn[3][3];
    for (int r = 0; r < 3; ++r) {
        e[r] = target[4 * r + 3] - m.p[r];
        for (int c = 0; c < 3; ++c)
            turn[r][c] = target[4 * r] * m.R[c][0] + target[4 * r + 1] * m.R[c][1] + target[4 * r + 2] * m.R[c][2];
    }
    const double x = turn[2][1] - turn[1][2], y = turn[0][2] - turn[2][0], z = turn[1][0] - turn[0][1];
    const double sine = std::sqrt(x * x + y * y + z * z);
    const double angle = std::atan2(sine, turn[0][0] + turn[1][1] + turn[2][2] - 1.0);
    const double scale = sine > 1e-12 ? angle / sine : 0.5;
    e[3] = scale * x, e[4] = scale * y, e[5] = scale * z;
}

// J⁺, transposed: (JJᵀ + λ²I)⁻¹ J by an LDLᵀ elimination, its rows padded to eight lanes.
inline void inverse(const Constants &k, const Motion<double> &m, Eight (&P)[6]) {
    double M[6][6];
    Eight rows[6] = {};
    for (int r = 0; r < 6; ++r)
        for (int i = 0; i < N; ++i) rows[r][i] = m.J[r][i];
    for (int r = 0; r < 6; ++r) {
        for (int c = 0; c <= r; ++c) {
            double sum = 0.0;
            for (int i = 0; i < N; ++i) sum += m.J[r][i] * m.J[c][i];
            M[r][c] = sum;
        }
        M[r][r] += k.damping * k.damping;
        P[r] = rows[r];
    }
    double reciprocal[6];
#pragma GCC unroll 6
    for (int j = 0; j < 6; ++j) {
        reciprocal[j] = 1.0 / M[j][j];
#pragma GCC unroll 6
        for (int i = j + 1; i < 6; ++i) {
            const double l = M[i][j] * reciprocal[j];
#pragma GCC unroll 6
            for (int c = j + 1; c <= i; ++c) M[i][c] -= l * M[c][j];
            P[i] -= l * P[j];
        }
    }
#pragma GCC unroll 6
    for (int j = 5; j >= 0; --j) {
        P[j] *= reciprocal[j];
#pragma GCC unroll 6
        for (int i = j + 1; i < 6; ++i) P[j] -= (M[i][j] * reciprocal[j]) * P[i];
    }
}

inline double sum(Eight v) {
    return ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7]));
}
inline Eight size(Eight v) { return v < 0.0 ? -v : v; }

// One step of law `paper`, equations (3) to (12) of the paper.
inline void step(const Constants &k, const double *q, const double *target, double *goal, double *limit) {
    Motion<double> m;
    double e[6];
    Eight P[6], gradient = {};
    kinematics(k, q, m);
    deviation(m, target, e);
    inverse(k, m, P);
    for (int i = 0; i < N; ++i) gradient[i] = (q[i] - k.rest[i]) + k.weights[i] * (q[i] - k.middle[i]);
    Eight motion = {}, null = gradient, torque = {};
    for (int r = 0; r < 6; ++r) {
        const double adapted = k.keep[r] * e[r];
        double along = 0.0;
        for (int i = 0; i < N; ++i) along += m.J[r][i] * gradient[i];
        motion += P[r] * (k.gain * adapted);
        null -= P[r] * along;
        double c = (k.d_plus[r] - std::fabs(adapted)) / (k.d_plus[r] - k.d_minus[r]);
        c = c < 0.0 ? 0.0 : c > 1.0 ? 1.0 : c;
        const Eight share = size(P[r]);
        torque += share * ((c * k.soft[r] + (1.0 - c) * k.firm[r]) / sum(share));
    }
    const Eight share = size(null);
    torque += share * (k.null_budget / sum(share));
    motion = k.horizon * (motion - k.alpha * null);
    for (int i = 0; i < N; ++i) {
        goal[i] = q[i] + motion[i];
        limit[i] = torque[i];
    }
}

} // namespace peer

//! 3-vector and 3×3 matrix algebra of the control step, for one configuration or several.

use super::simd::RealOps;

/// 3-vector, of one configuration or of several.
pub(crate) type Vec3<R = f64> = [R; 3];

/// 3×3 matrix `m[row][column]`, of one configuration or of several.
pub(crate) type Mat3<R = f64> = [[R; 3]; 3];

#[inline(always)]
pub(crate) fn dot<A: RealOps>(a: &Vec3<A::Real>, b: &Vec3<A::Real>) -> A::Real {
    A::fma(a[2], b[2], A::fma(a[1], b[1], a[0] * b[0]))
}

#[inline(always)]
pub(crate) fn cross<A: RealOps>(a: &Vec3<A::Real>, b: &Vec3<A::Real>) -> Vec3<A::Real> {
    [A::fnma(a[2], b[1], a[1] * b[2]), A::fnma(a[0], b[2], a[2] * b[0]), A::fnma(a[1], b[0], a[0] * b[1])]
}

#[inline(always)]
pub(crate) fn add<A: RealOps>(a: &Vec3<A::Real>, b: &Vec3<A::Real>) -> Vec3<A::Real> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline(always)]
pub(crate) fn sub<A: RealOps>(a: &Vec3<A::Real>, b: &Vec3<A::Real>) -> Vec3<A::Real> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Returns `s v`.
#[inline(always)]
pub(crate) fn scale<A: RealOps>(s: A::Real, v: &Vec3<A::Real>) -> Vec3<A::Real> {
    [s * v[0], s * v[1], s * v[2]]
}

/// Returns `m v`.
#[inline(always)]
pub(crate) fn rotate<A: RealOps>(m: &Mat3<A::Real>, v: &Vec3<A::Real>) -> Vec3<A::Real> {
    [dot::<A>(&m[0], v), dot::<A>(&m[1], v), dot::<A>(&m[2], v)]
}

/// Returns `m v + p`.
#[inline(always)]
pub(crate) fn place<A: RealOps>(m: &Mat3<A::Real>, v: &Vec3<A::Real>, p: &Vec3<A::Real>) -> Vec3<A::Real> {
    [
        A::fma(m[0][2], v[2], A::fma(m[0][1], v[1], A::fma(m[0][0], v[0], p[0]))),
        A::fma(m[1][2], v[2], A::fma(m[1][1], v[1], A::fma(m[1][0], v[0], p[1]))),
        A::fma(m[2][2], v[2], A::fma(m[2][1], v[1], A::fma(m[2][0], v[0], p[2]))),
    ]
}

/// Returns `mᵀ v`.
#[inline(always)]
pub(crate) fn tr_rotate<A: RealOps>(m: &Mat3<A::Real>, v: &Vec3<A::Real>) -> Vec3<A::Real> {
    [
        A::fma(m[2][0], v[2], A::fma(m[1][0], v[1], m[0][0] * v[0])),
        A::fma(m[2][1], v[2], A::fma(m[1][1], v[1], m[0][1] * v[0])),
        A::fma(m[2][2], v[2], A::fma(m[1][2], v[1], m[0][2] * v[0])),
    ]
}

/// Returns the matrix product `a b`.
#[inline(always)]
pub(crate) fn multiply<A: RealOps>(a: &Mat3<A::Real>, b: &Mat3<A::Real>) -> Mat3<A::Real> {
    [tr_rotate::<A>(b, &a[0]), tr_rotate::<A>(b, &a[1]), tr_rotate::<A>(b, &a[2])]
}

/// Returns the matrix product `a bᵀ`.
#[inline(always)]
pub(crate) fn mul_tr<A: RealOps>(a: &Mat3<A::Real>, b: &Mat3<A::Real>) -> Mat3<A::Real> {
    [rotate::<A>(b, &a[0]), rotate::<A>(b, &a[1]), rotate::<A>(b, &a[2])]
}

/// Broadcasts a vector to all configurations.
#[inline(always)]
pub(crate) fn splat<A: RealOps>(v: &Vec3) -> Vec3<A::Real> {
    [A::splat(v[0]), A::splat(v[1]), A::splat(v[2])]
}

/// Broadcasts a matrix to all configurations.
#[inline(always)]
pub(crate) fn splat_matrix<A: RealOps>(m: &Mat3) -> Mat3<A::Real> {
    [splat::<A>(&m[0]), splat::<A>(&m[1]), splat::<A>(&m[2])]
}

/// Returns `a + s b`.
#[inline(always)]
pub(crate) fn add_scaled<A: RealOps>(a: &Vec3<A::Real>, s: A::Real, b: &Vec3<A::Real>) -> Vec3<A::Real> {
    [A::fma(s, b[0], a[0]), A::fma(s, b[1], a[1]), A::fma(s, b[2], a[2])]
}

/// Returns the Euclidean norm of `v`.
#[inline(always)]
pub(crate) fn norm<A: RealOps>(v: &Vec3<A::Real>) -> A::Real {
    A::sqrt(dot::<A>(v, v))
}

/// Returns one step of the iteration `R (3 I − RᵀR) / 2`, which keeps a product of many rotations orthonormal.
#[inline(always)]
pub(crate) fn orthonormal<A: RealOps>(r: &Mat3<A::Real>) -> Mat3<A::Real> {
    let (half, mut correction) = (A::splat(0.5), [[A::splat(0.0); 3]; 3]);
    for i in 0..3 {
        for j in 0..=i {
            let dot = dot::<A>(&[r[0][i], r[1][i], r[2][i]], &[r[0][j], r[1][j], r[2][j]]);
            let value = A::fnma(half, dot, A::splat(if i == j { 1.5 } else { 0.0 }));
            (correction[i][j], correction[j][i]) = (value, value);
        }
    }
    multiply::<A>(r, &correction)
}

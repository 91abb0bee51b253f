//! Static forces that torque limits hold in one pose, from the transposed Jacobian.

use crate::{JointVec, MAX_JOINTS};

/// Lever, relative to the longest, below which a push does not load a joint.
const NO_LEVER: f64 = 1e-9;

/// The push along `a = Jᵀd` at which each joint yields: `(L_i + s_i g_i) / |a_i|`, `s_i = sign(a_i)`.
///
/// Servo i exerts `g_i − F a_i`, which may not fall below `−L_i` if the push turns it forward. ∞ for a joint that the
/// push does not load.
#[inline]
pub(crate) fn yield_forces(a: &JointVec, limit: &JointVec, gravity: &JointVec, n: usize) -> JointVec {
    let longest = a.iter().fold(0.0_f64, |max, x| max.max(x.abs()));
    let mut out = [f64::INFINITY; MAX_JOINTS];
    for i in 0..n.min(MAX_JOINTS) {
        if a[i].abs() > NO_LEVER * longest {
            out[i] = (limit[i] + a[i].signum() * gravity[i]) / a[i].abs();
        }
    }
    out
}

/// The largest static force that the limits hold against a push along `sign · d`: `min_i (L_i + s_i g_i) / |a_i|`.
///
/// Exact for a pure force at this pose, up to friction. Negative if the arm cannot hold itself. ∞ if the push loads no
/// joint.
#[inline]
pub(crate) fn static_force(a: &JointVec, sign: f64, limit: &JointVec, gravity: &JointVec, n: usize) -> f64 {
    let forces = yield_forces(&a.map(|lever| sign * lever), limit, gravity, n);
    forces.iter().fold(f64::INFINITY, |least, force| least.min(*force))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joints(values: &[f64]) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        out[..values.len()].copy_from_slice(values);
        out
    }

    /// Reference implementation by search: the largest F for which each loaded servo stays within its limit.
    fn searched(a: &JointVec, sign: f64, limit: &JointVec, gravity: &JointVec, n: usize) -> f64 {
        let holds = |force: f64| {
            (0..n).all(|i| {
                let (lever, torque) = (sign * a[i], gravity[i] - force * sign * a[i]);
                if lever > 0.0 { torque >= -limit[i] } else { lever == 0.0 || torque <= limit[i] }
            })
        };
        let (mut low, mut high) = (-1e3, 1e3);
        for _ in 0..80 {
            let middle = 0.5 * (low + high);
            if holds(middle) { low = middle } else { high = middle }
        }
        low
    }

    #[test]
    fn the_formula_agrees_with_a_search() {
        let noise = |i: usize| (((i + 1) as f64 * 12.9898).sin() * 43_758.545_3).fract();
        for seed in 0..500 {
            let draw = |from: usize| joints(&std::array::from_fn::<f64, 7, _>(|i| noise(seed * 40 + from + i)));
            let (a, gravity) = (draw(0), draw(10).map(|g| 3.0 * g));
            let limit = draw(20).map(|l| 4.0 * l.abs());
            for sign in [-1.0, 1.0] {
                let forces = yield_forces(&a.map(|x| sign * x), &limit, &gravity, 7);
                let force = static_force(&a, sign, &limit, &gravity, 7);
                let weakest = (0..7).find(|&i| forces[i] <= force).unwrap();
                let expected = searched(&a, sign, &limit, &gravity, 7);
                assert!((force - expected).abs() < 1e-9 * (1.0 + expected.abs()), "{force} {expected}");
                // The joint that yields is exactly at its limit.
                assert!(((gravity[weakest] - force * sign * a[weakest]).abs() - limit[weakest].abs()).abs() < 1e-9);
                // Reversing both axis and side gives the same push.
                let mirrored = static_force(&a.map(|x| -x), -sign, &limit, &gravity, 7);
                assert!((force - mirrored).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn an_arm_that_cannot_hold_itself_has_a_negative_force_toward_the_load() {
        let (a, limit, gravity) = (joints(&[0.5]), joints(&[2.0]), joints(&[-3.0]));
        assert!((static_force(&a, 1.0, &limit, &gravity, 1) + 2.0).abs() < 1e-15);
        assert!((static_force(&a, -1.0, &limit, &gravity, 1) - 10.0).abs() < 1e-15);
        assert!(static_force(&joints(&[0.0]), 1.0, &limit, &gravity, 1).is_infinite());
    }
}

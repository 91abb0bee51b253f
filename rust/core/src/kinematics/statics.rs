//! Static forces on the tool that joint torque limits can hold in one configuration, from the transposed Jacobian.

use crate::{JointVec, MAX_JOINTS};

/// A push does not load a joint if its lever about that joint is shorter than this share of its longest lever.
const MIN_RELATIVE_LEVER: f64 = 1e-9;

/// Returns the push along a direction d, with `a = Jᵀd`, at which each joint yields: `(L_i + s_i g_i) / |a_i|`, `s_i = sign(a_i)`.
///
/// L is the torque limit, g the gravity torque. Against a push F, servo i exerts `g_i − F a_i`, which must stay within
/// ±L_i. ∞ for a joint that the push does not load.
#[inline]
pub(crate) fn yield_forces(a: &JointVec, limit: &JointVec, gravity: &JointVec, n: usize) -> JointVec {
    let longest = a.iter().fold(0.0_f64, |max, x| max.max(x.abs()));
    let mut out = [f64::INFINITY; MAX_JOINTS];
    for i in 0..n.min(MAX_JOINTS) {
        if a[i].abs() > MIN_RELATIVE_LEVER * longest {
            out[i] = (limit[i] + a[i].signum() * gravity[i]) / a[i].abs();
        }
    }
    out
}

/// Returns the largest static force that the torque limits L hold against a push along `sign · d`, with `a = Jᵀd` and
/// the gravity torques g: `min_i (L_i + s_i g_i) / |a_i|`, `s_i = sign(sign · a_i)`.
///
/// Exact for a pure force in this configuration, without friction. Negative if the arm cannot hold its own weight; ∞ if
/// the push loads no joint.
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

    /// Searches the largest force at which each loaded servo stays within its limit, as a reference.
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

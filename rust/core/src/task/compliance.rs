//! Compliance and holding torque, equations (8) and (9) of the paper.

use crate::math::simd::{BaselineF64, RealOps};
use crate::params::Profile;

/// Returns the compliance c, equation (8) of the paper: 1 if the absolute deviation is below `soft_until`, 0 above
/// `firm_from`, linear between.
///
/// The paper omits the absolute value; every negative deviation would then be fully compliant.
pub fn compliance(deviation: f64, soft_until: f64, firm_from: f64) -> f64 {
    compliance_by::<BaselineF64>(deviation, firm_from, 1.0 / (firm_from - soft_until))
}

/// Computes [`compliance`] for one axis or for a vector of axes; `slope` is 1 / (firm_from − soft_until).
#[inline(always)]
pub(crate) fn compliance_by<A: RealOps>(deviation: A::Real, firm_from: A::Real, slope: A::Real) -> A::Real {
    clamp01::<A>((firm_from - A::abs(deviation)) * slope)
}

/// Clamps a number to [0, 1].
#[inline(always)]
pub(crate) fn clamp01<A: RealOps>(value: A::Real) -> A::Real {
    A::min(A::max(value, A::splat(0.0)), A::splat(1.0))
}

/// Interpolates linearly: `share · there + (1 − share) · here`.
#[inline(always)]
pub(crate) fn lerp<A: RealOps>(share: A::Real, here: A::Real, there: A::Real) -> A::Real {
    A::fma(share, there, (A::splat(1.0) - share) * here)
}

/// Returns the strength of a yielding axis at the compliance `c`: `c soft + (1 − c) firm` for [`Profile::Hardening`],
/// as in equation (9) of the paper.
pub fn strength(c: f64, soft: f64, firm: f64, profile: Profile) -> f64 {
    let [near, far] = profile.ends(soft, firm);
    lerp::<BaselineF64>(c, far, near)
}

/// Returns the holding torque of one axis, equation (9) of the paper: `c soft + (1 − c) firm` if compliant, else
/// `hold`.
pub fn holding_torque(c: f64, soft: f64, firm: f64, hold: f64, compliant: bool) -> f64 {
    if compliant { strength(c, soft, firm, Profile::Hardening) } else { hold }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn compliance_is_even_and_clamped() {
        for (d, c) in [(0.0, 1.0), (0.01, 1.0), (0.055, 0.5), (-0.055, 0.5), (0.1, 0.0), (-3.0, 0.0)] {
            assert!((compliance(d, 0.01, 0.1) - c).abs() < 1e-14);
        }
    }

    #[test]
    fn profiles_share_their_end_points() {
        let at = |c, profile| strength(c, 2.0, 10.0, profile);
        assert!((at(1.0, Profile::Hardening) - at(0.0, Profile::Softening)).abs() < 1e-15);
        assert!((at(0.3, Profile::Constant) - 2.0).abs() < 1e-15);
    }
}

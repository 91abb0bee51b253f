//! Compliance (8) and holding torque (9).

use crate::task::axes::Profile;

/// Compliance c ∈ [0, 1] of (8) for a deviation of any sign: 1 below `d_minus`, 0 above `d_plus`, linear between.
///
/// The paper prints d without absolute value, which would call every negative deviation fully compliant.
#[inline(always)]
pub fn compliance(deviation: f64, d_minus: f64, d_plus: f64) -> f64 {
    ((d_plus - deviation.abs()) / (d_plus - d_minus)).clamp(0.0, 1.0)
}

/// Strength of a yielding axis, (9): `c soft + (1 − c) firm`, or another profile over the same two values.
#[inline(always)]
pub fn strength(c: f64, soft: f64, firm: f64, profile: Profile) -> f64 {
    match profile {
        Profile::Firming => c * soft + (1.0 - c) * firm,
        Profile::Constant => soft,
        Profile::Yielding => c * firm + (1.0 - c) * soft,
    }
}

/// Holding torque of one axis as in (9): interpolated where the axis is compliant, `hold` where it is not.
#[inline(always)]
pub fn holding_torque(c: f64, soft: f64, firm: f64, hold: f64, compliant: bool) -> f64 {
    if compliant { strength(c, soft, firm, Profile::Firming) } else { hold }
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
        assert!((at(1.0, Profile::Firming) - at(0.0, Profile::Yielding)).abs() < 1e-15);
        assert!((at(0.3, Profile::Constant) - 2.0).abs() < 1e-15);
    }
}

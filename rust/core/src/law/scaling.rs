//! Scaling of the parts of a motion so that their sum satisfies a bound.

use crate::math::simd::JointVector;

/// Returns one factor in [0, 1] per part so that `|base + Σ f_p part_p| ≤ bound` for every joint. If `base` alone
/// exceeds the bound so far that this is impossible, the parts that increase the excess get the factor 0.
///
/// The parts are reduced in order: part 2 is scaled only if the bound is exceeded even with part 1 at zero.
#[inline(always)]
pub(crate) fn scale_to_fit<J: JointVector, const P: usize>(base: J, parts: [J; P], bound: J) -> [f64; P] {
    // Fast path without a branch per joint: usually the sum is within the bound.
    let mut all = base;
    for part in parts {
        all = all + part;
    }
    if bound.is_any_lt(J::abs(all)) { shrink(base, parts, bound) } else { [1.0; P] }
}

#[inline(always)]
fn shrink<J: JointVector, const P: usize>(base: J, parts: [J; P], bound: J) -> [f64; P] {
    let (zero, one) = (J::splat(0.0), J::splat(1.0));
    // Ignore parts and excesses at the level of rounding errors: scaling such a part does not help, and such an excess
    // remains after the previous part was scaled exactly to the bound.
    let rounding = bound * J::splat(1e-9);
    let mut factors = [1.0; P];
    for p in 0..P {
        let mut others = base;
        for o in 0..P {
            if o != p {
                others = J::fma(J::splat(factors[o]), parts[o], others);
            }
        }
        let (part, all) = (parts[p], others + parts[p]);
        let max = bound + rounding;
        if !max.is_any_lt(J::abs(all)) {
            break;
        }
        let room = (J::copy_sign(bound, all) - others) / part;
        let missing = one - J::min(J::max(room, zero), one);
        let missing = J::select_lt(rounding, J::abs(part), missing, zero);
        factors[p] = 1.0 - J::select_lt(max, J::abs(all), missing, zero).max_element();
    }
    factors
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MAX_JOINTS;
    use crate::math::simd::JointVec16;

    fn vector(values: &[f64]) -> JointVec16 {
        let mut out = [0.0; MAX_JOINTS];
        out[..values.len()].copy_from_slice(values);
        JointVec16::load(&out)
    }

    #[test]
    fn the_first_part_is_scaled_first() {
        let base = vector(&[1.0, 0.0]);
        let (soft, stiff, bound) = (vector(&[4.0, 1.0]), vector(&[6.0, 1.0]), vector(&[9.0, 9.0]));
        let factors = |bound: JointVec16| scale_to_fit(base, [soft, stiff], bound).map(f64::to_bits);
        assert_eq!(factors(bound), [0.5, 1.0].map(f64::to_bits));
        let bound = vector(&[4.0, 9.0]);
        assert_eq!(factors(bound), [0.0, 0.5].map(f64::to_bits));
        let bound = vector(&[20.0, 9.0]);
        assert_eq!(factors(bound), [1.0, 1.0].map(f64::to_bits));
    }

    #[test]
    fn a_rounding_error_at_the_bound_scales_nothing() {
        let base = vector(&[-4.1, 0.0]);
        for bound in [10.3, 10.7, 9.9, 6.4] {
            for soft in [17.3, 21.9, 30.1] {
                let parts = [vector(&[soft, 0.0]), vector(&[1e-17, 3.0])];
                let factors = scale_to_fit(base, parts, vector(&[bound, 9.0]));
                assert!((factors[1] - 1.0).abs() < 1e-9, "{factors:?}");
            }
        }
    }

    #[test]
    fn a_base_beyond_the_bound_removes_all_parts() {
        let factors = scale_to_fit(vector(&[5.0]), [vector(&[1.0]), vector(&[1.0])], vector(&[2.0]));
        assert_eq!(factors.map(f64::to_bits), [0, 0]);
    }
}

//! Halton sequence: joint positions spread evenly over their ranges, the same in every run.

use crate::{JointVec, MAX_JOINTS};

/// Bases of the sequence, one prime per joint.
const PRIMES: [u32; MAX_JOINTS] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53];

/// Returns point `index` ≥ 1 of the sequence [rad or m], scaled to the range from `lower` to `upper`; to ±π for joints
/// without limits.
pub(crate) fn joints(lower: &[f64], upper: &[f64], index: u32) -> JointVec {
    let mut q = [0.0; MAX_JOINTS];
    for ((value, (&lower, &upper)), base) in q.iter_mut().zip(lower.iter().zip(upper)).zip(PRIMES) {
        let (low, high) = if lower.is_finite() && upper.is_finite() {
            (lower, upper)
        } else {
            (-std::f64::consts::PI, std::f64::consts::PI)
        };
        *value = low + radical_inverse(index, base) * (high - low);
    }
    q
}

fn radical_inverse(mut index: u32, base: u32) -> f64 {
    let (mut inverse, mut scale) = (0.0, 1.0);
    while index > 0 {
        scale /= f64::from(base);
        inverse += scale * f64::from(index % base);
        index /= base;
    }
    inverse
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base_two_bisects_the_range() {
        let values = [1, 2, 3, 4].map(|index| radical_inverse(index, 2).to_bits());
        assert_eq!(values, [0.5, 0.25, 0.75, 0.125].map(f64::to_bits));
    }
}

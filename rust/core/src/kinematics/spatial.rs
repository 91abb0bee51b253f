//! Small fixed-size algebra of the hot path: 3-vectors, 3×3 matrices, and sine and cosine of all joints at once.

/// 3-vector.
pub(crate) type Vec3 = [f64; 3];

/// 3×3 matrix, `m[row][column]`.
pub(crate) type Mat3 = [[f64; 3]; 3];

#[inline]
pub(crate) fn dot(a: &Vec3, b: &Vec3) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline]
pub(crate) fn cross(a: &Vec3, b: &Vec3) -> Vec3 {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline]
pub(crate) fn add(a: &Vec3, b: &Vec3) -> Vec3 {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

#[inline]
pub(crate) fn sub(a: &Vec3, b: &Vec3) -> Vec3 {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `m v`.
#[inline]
pub(crate) fn rotate(m: &Mat3, v: &Vec3) -> Vec3 {
    [dot(&m[0], v), dot(&m[1], v), dot(&m[2], v)]
}

/// `mᵀ v`.
#[inline]
pub(crate) fn rotate_back(m: &Mat3, v: &Vec3) -> Vec3 {
    [
        m[0][0] * v[0] + m[1][0] * v[1] + m[2][0] * v[2],
        m[0][1] * v[0] + m[1][1] * v[1] + m[2][1] * v[2],
        m[0][2] * v[0] + m[1][2] * v[1] + m[2][2] * v[2],
    ]
}

/// `a b`.
#[inline]
pub(crate) fn multiply(a: &Mat3, b: &Mat3) -> Mat3 {
    [rotate_back(b, &a[0]), rotate_back(b, &a[1]), rotate_back(b, &a[2])]
}

/// π/2 in three parts. The first two have 33 bits, so that their products with a whole number below 2²⁰ are exact.
const HALF_PI: [f64; 3] = [1.570_796_326_734_125_6, 6.077_100_506_303_966e-11, 2.022_266_248_795_950_6e-21];

/// Adding and subtracting 1.5·2⁵² rounds to the nearest whole number, whose last bits are then the last of the sum.
const ROUND: f64 = 6_755_399_441_055_744.0;

/// Sine and cosine of `angle` [rad] to 2.3e-16 for |angle| up to [`COORDINATE_BOUND`](crate::pose::COORDINATE_BOUND).
///
/// Without branches, tables and calls, so that a loop over joints becomes vector code, and the same on every system.
/// Reduction to |r| ≤ π/4 after Cody and Waite, then the Taylor series: its first term left out is below 5e-17.
#[inline(always)]
#[expect(clippy::inline_always, reason = "a call per joint would spill every vector register")]
pub(crate) fn sin_cos(angle: f64) -> (f64, f64) {
    let sum = angle * std::f64::consts::FRAC_2_PI + ROUND;
    let turns = sum - ROUND;
    let quadrant = sum.to_bits();
    let r = ((angle - turns * HALF_PI[0]) - turns * HALF_PI[1]) - turns * HALF_PI[2];
    let r2 = r * r;
    let r4 = r2 * r2;
    // Pairs of terms, so that the additions of one series overlap.
    let sine_low = (-1.0 / 6.0 + r2 / 120.0) + r4 * (-1.0 / 5_040.0 + r2 * (1.0 / 362_880.0));
    let sine_high = (-1.0 / 39_916_800.0 + r2 * (1.0 / 6_227_020_800.0)) - r4 * (1.0 / 1_307_674_368_000.0);
    let sine = r + r * r2 * (sine_low + (r4 * r4) * sine_high);
    let cosine_low = (1.0 / 24.0 - r2 / 720.0) + r4 * (1.0 / 40_320.0 - r2 * (1.0 / 3_628_800.0));
    let cosine_high = (1.0 / 479_001_600.0 - r2 * (1.0 / 87_178_291_200.0)) + r4 * (1.0 / 20_922_789_888_000.0);
    let cosine = (1.0 - 0.5 * r2) + r4 * (cosine_low + (r4 * r4) * cosine_high);
    // Odd quadrants swap the two; the sign bits follow from the quadrant.
    let swap = (quadrant & 1).wrapping_neg();
    let (s, c) = (sine.to_bits(), cosine.to_bits());
    let exchanged = (s ^ c) & swap;
    let sine_sign = (quadrant & 2) << 62;
    let cosine_sign = (quadrant.wrapping_add(1) & 2) << 62;
    (f64::from_bits((s ^ exchanged) ^ sine_sign), f64::from_bits((c ^ exchanged) ^ cosine_sign))
}

#[cfg(test)]
mod tests {
    use super::sin_cos;

    /// Largest difference to the system's functions over a dense walk with irrational step.
    fn worst(largest: f64) -> f64 {
        (0..400_000)
            .map(|i| {
                let angle = (f64::from(i) * 0.618_033_988_749_895).fract() * 2.0 * largest - largest;
                let (sine, cosine) = sin_cos(angle);
                (sine - angle.sin()).abs().max((cosine - angle.cos()).abs())
            })
            .fold(0.0, f64::max)
    }

    #[test]
    fn sines_are_right_to_rounding() {
        for largest in [1e-9, 0.8, 3.2, 100.0, 1e4, 1e6] {
            let off = worst(largest);
            assert!(off <= 2.3e-16, "within ±{largest}: {off:e}");
        }
    }

    #[test]
    fn sines_at_multiples_of_a_quarter_turn() {
        for i in -1000..1000_i32 {
            let angle = f64::from(i) * std::f64::consts::FRAC_PI_2;
            let (sine, cosine) = sin_cos(angle);
            assert!((sine - angle.sin()).abs() <= 1.2e-16 && (cosine - angle.cos()).abs() <= 1.2e-16, "{i}");
        }
        assert_eq!(sin_cos(0.0).0.to_bits(), 0.0_f64.to_bits());
        assert_eq!(sin_cos(0.0).1.to_bits(), 1.0_f64.to_bits());
    }
}

//! Rounding of default values and of numbers in messages.

/// Returns a positive value rounded to two significant digits (0.1465 → 0.15); 0 for any other value.
pub(crate) fn round_to_two_digits(value: f64) -> f64 {
    if !(value > 0.0 && value.is_finite()) {
        return 0.0;
    }
    let step = 10.0_f64.powf(value.log10().floor() - 1.0);
    (value / step).round() * step
}

/// Returns a positive value rounded to halves of its leading decade (4.03 → 4, 15.1 → 15, 0.948 → 0.95); 0 for any
/// other value.
pub(crate) fn round_to_halves(value: f64) -> f64 {
    if !(value > 0.0 && value.is_finite()) {
        return 0.0;
    }
    let step = 0.5 * 10.0_f64.powf(value.log10().floor());
    (value / step).round() * step
}

/// Returns a positive value rounded down to two significant digits; any other value unchanged.
pub(crate) fn round_down(value: f64) -> f64 {
    digits(value, f64::floor)
}

/// Returns a positive value rounded up to two significant digits; any other value unchanged.
pub(crate) fn round_up(value: f64) -> f64 {
    digits(value, f64::ceil)
}

fn digits(value: f64, round: impl Fn(f64) -> f64) -> f64 {
    if !(value > 0.0 && value.is_finite()) {
        return value;
    }
    // Scale by a power of ten ≥ 1, which is exact in floating point, so that 0.3 stays 0.3.
    let exponent = 1.0 - value.log10().floor();
    if exponent >= 0.0 {
        let scale = 10.0_f64.powf(exponent).round();
        round(value * scale) / scale
    } else {
        let step = 10.0_f64.powf(-exponent).round();
        round(value / step) * step
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding() {
        for (value, rounded) in [(4.03, 4.0), (15.1, 15.0), (0.948, 0.95), (40.3, 40.0), (3.555, 3.5), (0.0, 0.0)] {
            assert!((round_to_halves(value) - rounded).abs() < 1e-12);
        }
        for (value, rounded) in [(0.1465, 0.15), (0.0195, 0.02), (12.3, 12.0), (0.0, 0.0)] {
            assert!((round_to_two_digits(value) - rounded).abs() < 1e-12);
        }
    }
}

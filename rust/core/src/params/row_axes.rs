//! Force caps and adaptation of one arm of a batch, which replace those of the settings.

use crate::MAX_AXES;
use crate::error::{Error, Result};
use crate::params::{AXIS_NAMES, Params};

/// Force caps [N, N·m; N·m under law `paper`] and adaptation η of one arm of a batch, for x, y, z, roll, pitch, yaw.
/// `None`: the values of the settings.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RowAxes<'a> {
    pub(crate) caps: Option<&'a [f64]>,
    pub(crate) adaptation: Option<&'a [f64]>,
}

impl RowAxes<'_> {
    /// Returns true if all axes have the values of the settings.
    #[inline(always)]
    fn is_empty(self) -> bool {
        self.caps.is_none() && self.adaptation.is_none()
    }
}

impl Params {
    /// Checks the caps and the adaptation of arm `row` of a batch: within their bounds for axes that yield, NaN for the
    /// others.
    #[inline(always)]
    pub(crate) fn check_row_axes(&self, row: usize, axes: RowAxes<'_>) -> Result<()> {
        if axes.is_empty() { Ok(()) } else { self.check_values(row, axes) }
    }

    #[inline(never)]
    fn check_values(&self, row: usize, axes: RowAxes<'_>) -> Result<()> {
        // Largest cap and adaptation of each axis; NaN for axes that do not yield.
        let (mut holds, mut etas) = ([f64::NAN; MAX_AXES], [f64::NAN; MAX_AXES]);
        let max = self.max_adaptation;
        for axis in self.per_axis.iter().take(self.k).filter(|axis| axis.is_compliant()) {
            (holds[axis.axis], etas[axis.axis]) = (axis.hold, max.min(1.0_f64.next_down()));
        }
        if let Some((axis, value)) = first_invalid(axes.caps, &holds) {
            let (hold, unit) = (holds[axis], if self.law.by_force() && axis < 3 { "N" } else { "N·m" });
            let bound = format!("[0, {hold}]: the axis holds with {hold} {unit}, see `hold` in the settings");
            return Err(invalid_value(axis, value, hold, &format!(" [{unit}]"), bound).in_row("caps", row));
        }
        if let Some((axis, value)) = first_invalid(axes.adaptation, &etas) {
            let bound = if max < 1.0 {
                format!("[0, {max}], the bound while k_p is not known within 10 %")
            } else {
                "[0, 1)".into()
            };
            return Err(invalid_value(axis, value, etas[axis], "", bound).in_row("adaptation", row));
        }
        Ok(())
    }

    /// Replaces caps and adaptation of the yielding axes by values that [`Params::check_row_axes`] has accepted.
    #[inline(always)]
    pub(crate) fn set_row_axes(&mut self, axes: RowAxes<'_>) {
        if !axes.is_empty() {
            self.set_values(axes);
        }
    }

    #[inline(never)]
    fn set_values(&mut self, axes: RowAxes<'_>) {
        for r in 0..self.k.min(MAX_AXES) {
            let axis = self.per_axis[r].axis;
            if !self.per_axis[r].is_compliant() {
                continue;
            }
            let rows = &mut self.axis_simd;
            if let Some(&cap) = axes.caps.and_then(|caps| caps.get(axis)) {
                for side in 0..2 {
                    (rows.near_strength[side][r], rows.far_strength[side][r]) = (cap, cap);
                }
            }
            if let Some(&eta) = axes.adaptation.and_then(|adaptation| adaptation.get(axis)) {
                rows.eta[r] = eta;
            }
        }
    }
}

/// Returns the first axis whose value is not between 0 and its bound in `max`, or is not NaN where the bound is NaN; also
/// returns the value.
#[inline(never)]
fn first_invalid(values: Option<&[f64]>, max: &[f64]) -> Option<(usize, f64)> {
    for (axis, (&value, &max)) in values?.iter().zip(max).enumerate() {
        let is_valid = if max.is_nan() { value.is_nan() } else { (0.0..=max).contains(&value) };
        if !is_valid {
            return Some((axis, value));
        }
    }
    None
}

/// Returns the error for an invalid value of `axis`, whose bound `max` is NaN if it does not yield.
#[cold]
#[inline(never)]
fn invalid_value(axis: usize, value: f64, max: f64, unit: &str, bound: String) -> Error {
    let name = AXIS_NAMES[axis];
    if max.is_nan() {
        let message = format!(
            "{value} has no effect, because the settings have no axis {name} that yields: use NaN here, or settings in \
             which it yields"
        );
        return Error::config(name, message);
    }
    Error::out_of_range(format!("{name}{unit}"), value, bound)
}

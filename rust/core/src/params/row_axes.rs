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
        let each = |argument: &str, values: Option<&[f64]>, check: &dyn Fn(usize, f64) -> Result<()>| {
            for (axis, &value) in values.into_iter().flatten().enumerate() {
                let name = AXIS_NAMES.get(axis).copied().unwrap_or_default();
                let checked = match self.row_that_yields(axis) {
                    Some(r) => check(r, value),
                    None if value.is_nan() => Ok(()),
                    None => Err(Error::config(
                        name,
                        format!(
                            "{value} has no effect, because the settings have no axis {name} that yields: use NaN here, \
                             or settings in which it yields"
                        ),
                    )),
                };
                checked.map_err(|error| error.in_row(argument, row))?;
            }
            Ok(())
        };
        let (by_force, name) = (self.law.by_force(), |r: usize| AXIS_NAMES[self.per_axis[r].axis]);
        each("caps", axes.caps, &|r, value| {
            let hold = self.per_axis[r].hold;
            if (0.0..=hold).contains(&value) {
                return Ok(());
            }
            let unit = if by_force && self.per_axis[r].axis < 3 { "N" } else { "N·m" };
            let bound = format!("[0, {hold}]: the axis holds with {hold} {unit}, see `hold` in the settings");
            Err(Error::out_of_range(format!("{} [{unit}]", name(r)), value, bound))
        })?;
        each("adaptation", axes.adaptation, &|r, value| {
            let max = self.max_adaptation;
            if (0.0..1.0).contains(&value) && value <= max {
                return Ok(());
            }
            let bound = if max < 1.0 {
                format!("[0, {max}], the bound while k_p is not known within 10 %")
            } else {
                "[0, 1)".into()
            };
            Err(Error::out_of_range(name(r), value, bound))
        })
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

    /// Returns the task row of this axis; `None` if the axis does not yield or is not in the task.
    fn row_that_yields(&self, axis: usize) -> Option<usize> {
        let rows = self.per_axis.iter().take(self.k);
        rows.enumerate().find(|(_, row)| row.axis == axis && row.is_compliant()).map(|(r, _)| r)
    }
}

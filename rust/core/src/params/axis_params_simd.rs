//! The task axes in vector layout.

use crate::math::rotation::into_frame;
use crate::math::simd::{Arithmetic, Axes, AxisScalar, LANES};
use crate::math::spatial::Mat3;
use crate::params::axis_params::Row;
use crate::params::{Frame, Plan};
use crate::{AxisVec, MAX_AXES};

/// One number per task row, then a padding value that keeps the spare lanes at zero.
pub(crate) type AxisLanes = [f64; LANES];

/// Every field of the [`Row`]s as one vector; pairs are (pushed toward −, toward +).
#[derive(Debug, Clone)]
pub(crate) struct RowLanes {
    /// Index among x, y, z, roll, pitch, yaw, 6 for a spare row.
    axis: [usize; MAX_AXES],
    pub(crate) yields: [AxisLanes; 2],
    /// Strength at a small and at a large deviation.
    pub(crate) near: [AxisLanes; 2],
    pub(crate) far: [AxisLanes; 2],
    pub(crate) hold: AxisLanes,
    pub(crate) stiffness: [AxisLanes; 2],
    pub(crate) viscosity: [AxisLanes; 2],
    pub(crate) eta: AxisLanes,
    pub(crate) firm_from: AxisLanes,
    /// 1 / (firm_from − soft_until), 1 / (2 band): precomputed, so that the step has no division for them.
    pub(crate) d_slope: AxisLanes,
    /// 1 / deviation at which a push is detected: soft_until, at least a tenth of firm_from.
    pub(crate) push_slope: AxisLanes,
    pub(crate) band: AxisLanes,
    pub(crate) band_slope: AxisLanes,
    pub(crate) step_limit: AxisLanes,
    pub(crate) soft_step_limit: AxisLanes,
    pub(crate) damping_scale: AxisLanes,
    /// Columns of K_x.
    pub(crate) kx: [AxisLanes; MAX_AXES],
}

impl RowLanes {
    pub(crate) fn new(rows: &[Row], damping_scale: &AxisVec, kx: &[[f64; MAX_AXES]; MAX_AXES]) -> Self {
        let of = |field: &dyn Fn(&Row) -> f64| {
            let mut out = [0.0; LANES];
            for (slot, row) in out.iter_mut().zip(rows) {
                *slot = field(row);
            }
            out
        };
        let ends = |row: &Row, side: usize| -> [f64; 2] { row.profile.ends(row.soft[side], row.firm[side]) };
        let mut spread_damping = [0.0; LANES];
        spread_damping[..MAX_AXES].copy_from_slice(damping_scale);
        let (mut columns, mut axis) = ([[0.0; LANES]; MAX_AXES], [MAX_AXES; MAX_AXES]);
        for (r, row) in rows.iter().enumerate() {
            axis[r] = row.axis;
            (0..MAX_AXES).for_each(|c| columns[c][r] = kx[r][c]);
        }
        Self {
            axis,
            yields: [0, 1].map(|side| of(&|row| row.yields[side])),
            near: [0, 1].map(|side| of(&|row| ends(row, side)[0])),
            far: [0, 1].map(|side| of(&|row| ends(row, side)[1])),
            hold: of(&|row| row.hold),
            stiffness: [0, 1].map(|side| of(&|row| row.stiffness[side])),
            viscosity: [0, 1].map(|side| of(&|row| row.viscosity[side])),
            eta: of(&|row| row.eta),
            firm_from: of(&|row| row.firm_from),
            d_slope: of(&|row| 1.0 / (row.firm_from - row.soft_until)),
            push_slope: of(&|row| 1.0 / row.soft_until.max(0.1 * row.firm_from)),
            band: of(&|row| row.band),
            band_slope: of(&|row| 0.5 / row.band),
            step_limit: of(&|row| row.step_limit),
            soft_step_limit: of(&|row| row.soft_step_limit),
            damping_scale: spread_damping,
            kx: columns,
        }
    }
}

impl Plan {
    /// Transforms a vector in base axes into one number per task row.
    #[inline(always)]
    pub(crate) fn in_rows<W: Axes>(&self, base_from_task: &Mat3<AxisScalar<W>>, v: &[AxisScalar<W>; MAX_AXES]) -> W {
        if matches!(self.frame, Frame::Base) {
            return self.of_rows(v);
        }
        self.of_rows(&into_frame::<W::One>(base_from_task, v))
    }

    /// Selects the task's entries of a vector over x, y, z, roll, pitch, yaw, in the order of its rows.
    #[inline(always)]
    pub(crate) fn of_rows<W: Axes>(&self, v: &[AxisScalar<W>; MAX_AXES]) -> W {
        let all = W::of_axes(v);
        if self.k == MAX_AXES {
            return all;
        }
        // Runtime indexing forces a spill. Spill a copy here so that the full-task path above stays in registers.
        let (all, nothing) = (all.axes(), W::One::splat(0.0));
        let mut out = [nothing; MAX_AXES];
        for r in 0..MAX_AXES {
            if let Some(&value) = all.get(self.lanes.axis[r]) {
                out[r] = value;
            }
        }
        W::of_axes(&out)
    }
}

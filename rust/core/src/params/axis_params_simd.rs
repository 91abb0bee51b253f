//! Parameters of the task axes in vector layout.

use crate::math::rotation::base_to_task;
use crate::math::simd::{F64x8, LANES};
use crate::math::spatial::Mat3;
use crate::params::axis_params::AxisParams;
use crate::params::{Features, Frame, Params};
use crate::{AxisVec, MAX_AXES};

/// One number per task axis; the unused lanes contain a value with which all results in them are zero.
pub(crate) type AxisArray = [f64; LANES];

/// The fields of [`AxisParams`] as vectors over the task rows; pairs are (pushed toward −, pushed toward +).
#[derive(Debug, Clone)]
pub(crate) struct AxisParamsSimd {
    /// Index of each row's axis among x, y, z, roll, pitch, yaw; 6 for a spare row.
    axis: [usize; MAX_AXES],
    /// 1 for a side that yields, else 0.
    pub(crate) yields: [AxisArray; 2],
    /// Strength of a yielding side at a small deviation.
    pub(crate) near_strength: [AxisArray; 2],
    /// Strength of a yielding side at a large deviation.
    pub(crate) far_strength: [AxisArray; 2],
    /// Strength of a side that does not yield.
    pub(crate) hold: AxisArray,
    /// Stiffness on either side of the target [N/m, N·m/rad]; 0 except under law `impedance`.
    pub(crate) stiffness: [AxisArray; 2],
    /// Damping on either side of the target [N·s/m, N·m·s/rad]; 0 except under law `impedance`.
    pub(crate) damping: [AxisArray; 2],
    /// Target adaptation η.
    pub(crate) eta: AxisArray,
    /// Deviation [m, rad] above which the compliance is 0.
    pub(crate) firm_from: AxisArray,
    /// Slope 1 / (firm_from − soft_until) of the compliance, precomputed to save a division in the step.
    pub(crate) compliance_slope: AxisArray,
    /// Reciprocal of the deviation above which a push is detected: `soft_until`, at least a tenth of `firm_from`.
    pub(crate) push_slope: AxisArray,
    /// Half-width [m, rad] of the band around deviation zero in which an axis blends between its sides.
    pub(crate) band: AxisArray,
    /// 1 / (2 band), precomputed to save a division in the step.
    pub(crate) band_slope: AxisArray,
    /// Limit of the commanded velocity of a stiff axis [m/s, rad/s].
    pub(crate) step_limit: AxisArray,
    /// Limit of the commanded velocity of a yielding axis [m/s, rad/s].
    pub(crate) soft_step_limit: AxisArray,
    /// Factor on the squared damping λ² of each row.
    pub(crate) damping_scale: AxisArray,
    /// True if an axis of the task has a limit of its commanded velocity.
    pub(crate) limits_steps: bool,
    /// Columns of the gain K_x [1/s].
    pub(crate) kx: [AxisArray; MAX_AXES],
    /// Diagonal of the gain K_x [1/s].
    pub(crate) kx_diagonal: AxisArray,
}

impl AxisParamsSimd {
    pub(crate) fn new(rows: &[AxisParams], damping_scale: &AxisVec, kx: &[[f64; MAX_AXES]; MAX_AXES]) -> Self {
        let of = |field: &dyn Fn(&AxisParams) -> f64| {
            let mut out = [0.0; LANES];
            for (slot, row) in out.iter_mut().zip(rows) {
                *slot = field(row);
            }
            out
        };
        let ends = |row: &AxisParams, side: usize| -> [f64; 2] { row.profile.ends(row.soft[side], row.firm[side]) };
        let mut spread_damping = [0.0; LANES];
        spread_damping[..MAX_AXES].copy_from_slice(damping_scale);
        let (mut columns, mut axis) = ([[0.0; LANES]; MAX_AXES], [MAX_AXES; MAX_AXES]);
        let mut kx_diagonal = [0.0; LANES];
        for (r, row) in rows.iter().enumerate() {
            (axis[r], kx_diagonal[r]) = (row.axis, kx[r][r]);
            (0..MAX_AXES).for_each(|c| columns[c][r] = kx[r][c]);
        }
        Self {
            axis,
            yields: [0, 1].map(|side| of(&|row| row.yields[side])),
            near_strength: [0, 1].map(|side| of(&|row| ends(row, side)[0])),
            far_strength: [0, 1].map(|side| of(&|row| ends(row, side)[1])),
            hold: of(&|row| row.hold),
            stiffness: [0, 1].map(|side| of(&|row| row.stiffness[side])),
            damping: [0, 1].map(|side| of(&|row| row.damping[side])),
            eta: of(&|row| row.eta),
            firm_from: of(&|row| row.firm_from),
            compliance_slope: of(&|row| 1.0 / (row.firm_from - row.soft_until)),
            push_slope: of(&|row| 1.0 / row.soft_until.max(0.1 * row.firm_from)),
            band: of(&|row| row.band),
            band_slope: of(&|row| 0.5 / row.band),
            step_limit: of(&|row| row.step_limit),
            soft_step_limit: of(&|row| row.soft_step_limit),
            damping_scale: spread_damping,
            limits_steps: rows.iter().any(|row| row.step_limit.min(row.soft_step_limit).is_finite()),
            kx: columns,
            kx_diagonal,
        }
    }
}

impl Params {
    /// Transforms a 6-vector in base axes into the task frame and returns the entries of the task rows.
    #[inline(always)]
    pub(crate) fn to_task_rows<W: F64x8>(&self, features: Features, base_from_task: &Mat3, v: &AxisVec) -> W {
        if !features.any_axes {
            return W::from_axes(v);
        }
        if matches!(self.frame, Frame::Base) {
            return self.select_rows(v);
        }
        self.select_rows(&base_to_task::<W::Elem>(base_from_task, v))
    }

    /// Returns the entries of the task rows from a vector over x, y, z, roll, pitch, yaw.
    #[inline(always)]
    pub(crate) fn select_rows<W: F64x8>(&self, v: &AxisVec) -> W {
        let all = W::from_axes(v);
        if self.k == MAX_AXES {
            return all;
        }
        // Indexing at run time requires an array in memory. Only this copy is one, so the path for all six axes stays
        // in registers.
        let (all, mut out) = (all.to_axes(), [0.0; MAX_AXES]);
        for r in 0..MAX_AXES {
            if let Some(&value) = all.get(self.axis_simd.axis[r]) {
                out[r] = value;
            }
        }
        W::from_axes(&out)
    }
}

//! Geometric Jacobian from the frames of the joints.

use super::forward::{JointFrames, Visitor};
use crate::math::rows::{load_rows, store_rows};
use crate::math::simd::{BaselineF64, JointVec16, JointVector, RealOps, ScalarVec3, Vec3Ops};
use crate::math::spatial::{Mat3, Vec3, cross, dot, sub, tr_rotate};
use crate::model::Chain;
use crate::pose::Pose;
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Visitor that stores each joint's origin in the linear rows and its axis in the angular rows. The linear rows are
/// completed once the tool position is known.
struct OriginsAndAxes<'a, R>(&'a mut [[R; MAX_JOINTS]; MAX_AXES]);

impl<A: RealOps> Visitor<ScalarVec3<A>> for OriginsAndAxes<'_, A::Real> {
    #[inline(always)]
    fn visit_joint(&mut self, k: usize, axes: &[ScalarVec3<A>; 3], origin: ScalarVec3<A>) {
        let (origin, axis) = (origin.components(), axes[2].components());
        for i in 0..3 {
            self.0[i][k] = origin[i];
            self.0[i + 3][k] = axis[i];
        }
    }
}

impl Chain {
    /// Computes the geometric Jacobian at the tool, base axes, linear rows first [m/rad, rad/rad; m/m, rad/m for
    /// prismatic joints].
    ///
    /// The column of a revolute joint at `o` with axis `z` is `[z × (p − o); z]` for the tool at `p`, that of a
    /// prismatic joint `[z; 0]`. A mimic joint adds its column times its multiplier to the column of the joint that
    /// drives it.
    pub fn jacobian(&self, frames: &JointFrames, rows: &mut Rows) {
        self.jacobian_by::<BaselineF64>(frames, rows);
    }

    /// Computes [`Chain::jacobian`] for one configuration or for several.
    #[inline(always)]
    pub(crate) fn jacobian_by<A: RealOps>(
        &self,
        frames: &JointFrames<A::Real>,
        rows: &mut [[A::Real; MAX_JOINTS]; MAX_AXES],
    ) {
        for row in rows.iter_mut() {
            for i in 0..self.n.min(MAX_JOINTS) {
                row[i] = A::splat(0.0);
            }
        }
        let tool = &frames.tool.position;
        for k in 0..self.path.min(MAX_JOINTS) {
            let axis = &frames.axis[k];
            let lever = cross::<A>(axis, &sub::<A>(tool, &frames.origin[k]));
            let (turn, slide) = (A::splat(self.angle_per_q[k]), A::splat(self.slide_per_q[k]));
            let column = self.driver[k] & (MAX_JOINTS - 1);
            for i in 0..3 {
                rows[i][column] = A::fma(turn, lever[i], A::fma(slide, axis[i], rows[i][column]));
                rows[i + 3][column] = A::fma(turn, axis[i], rows[i + 3][column]);
            }
        }
    }

    /// Computes tool pose and Jacobian of one configuration or of several; writes only the first `n` columns of `rows`.
    #[inline(always)]
    pub(crate) fn kinematics_by<A: RealOps>(
        &self,
        q: &[A::Real; MAX_JOINTS],
        rows: &mut [[A::Real; MAX_JOINTS]; MAX_AXES],
    ) -> Pose<A::Real> {
        if !self.simple {
            let mut frames = JointFrames::filled(A::splat(0.0));
            self.forward_by::<A>(q, &mut frames);
            self.jacobian_by::<A>(&frames, rows);
            return frames.tool;
        }
        let tool = self.forward_pass::<ScalarVec3<A>, MAX_JOINTS, true>(
            &self.joint_trigs::<A>(q, self.path),
            &mut OriginsAndAxes(rows),
        );
        for k in 0..self.n.min(MAX_JOINTS) {
            replace_origin::<A>(k, &tool.position, rows);
        }
        tool
    }
}

/// Replaces the origin `o` of joint `k` in the linear rows by `z × (p − o)` with its axis `z`.
#[inline(always)]
fn replace_origin<A: RealOps>(k: usize, tool: &Vec3<A::Real>, rows: &mut [[A::Real; MAX_JOINTS]; MAX_AXES]) {
    let axis = [rows[3][k], rows[4][k], rows[5][k]];
    let lever = cross::<A>(&axis, &sub::<A>(tool, &[rows[0][k], rows[1][k], rows[2][k]]));
    for i in 0..3 {
        rows[i][k] = lever[i];
    }
}

/// Rotates a Jacobian from base axes into the axes of the tool.
#[inline(always)]
pub(super) fn rotate_to_tool<A: RealOps>(tool: &Mat3<A::Real>, rows: &mut [[A::Real; MAX_JOINTS]; MAX_AXES], n: usize) {
    for k in 0..n.min(MAX_JOINTS) {
        let linear = tr_rotate::<A>(tool, &[rows[0][k], rows[1][k], rows[2][k]]);
        let angular = tr_rotate::<A>(tool, &[rows[3][k], rows[4][k], rows[5][k]]);
        for i in 0..3 {
            (rows[i][k], rows[i + 3][k]) = (linear[i], angular[i]);
        }
    }
}

/// Returns the Jacobian rows of the task's axes in the task frame, from the 6 × n Jacobian in base axes; rows after the
/// last axis are 0.
pub(crate) fn task_rows(j_base: &Rows, base_from_task: &[[f64; 3]; 3], axes: &[usize]) -> Rows {
    store_rows(&rotated_rows::<JointVec16>(&load_rows(j_base), base_from_task, axes))
}

/// Returns the row of [`task_rows`] for one axis.
pub(crate) fn task_row(j_base: &Rows, base_from_task: &Mat3, axis: usize) -> JointVec {
    let ((block, column), mut out) = (block_and_column(axis), [0.0; MAX_JOINTS]);
    let along = [base_from_task[0][column], base_from_task[1][column], base_from_task[2][column]];
    for (i, slot) in out.iter_mut().enumerate() {
        *slot = dot::<BaselineF64>(&along, &[j_base[block][i], j_base[block + 1][i], j_base[block + 2][i]]);
    }
    out
}

/// Returns the first row of the Jacobian's block of a task axis (0: linear, 3: angular), and the index of the axis (0
/// to 2) in the task frame.
#[inline(always)]
fn block_and_column(axis: usize) -> (usize, usize) {
    if axis < 3 { (0, axis) } else { (3, (axis - 3) % 3) }
}

/// Computes [`task_rows`] for rows in registers, of one configuration or of several.
#[inline(always)]
pub(crate) fn rotated_rows<J: JointVector>(
    j_base: &[J; MAX_AXES],
    base_from_task: &Mat3,
    axes: &[usize],
) -> [J; MAX_AXES] {
    let mut out = [J::splat(0.0); MAX_AXES];
    for r in 0..axes.len().min(MAX_AXES) {
        let (block, column) = block_and_column(axes[r]);
        let [x, y, z] = [
            J::splat(base_from_task[0][column]),
            J::splat(base_from_task[1][column]),
            J::splat(base_from_task[2][column]),
        ];
        out[r] = J::fma(z, j_base[block + 2], J::fma(y, j_base[block + 1], x * j_base[block]));
    }
    out
}

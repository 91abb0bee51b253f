//! Frames → geometric Jacobian.

use super::forward::Frames;
use super::spatial::{cross, sub};
use crate::model::Chain;
use crate::{MAX_JOINTS, Rows};

impl Chain {
    /// Geometric Jacobian at the tool, base axes, linear rows first [m/rad, rad/rad; m/m, rad/m for prismatic joints].
    ///
    /// A revolute joint at `o` with axis `z` moves the tool at `p` with `[z × (p − o); z]`, a prismatic one with
    /// `[z; 0]`. A joint that follows another adds its multiplier times that into its driver's column.
    pub fn jacobian(&self, frames: &Frames, rows: &mut Rows) {
        *rows = [[0.0; MAX_JOINTS]; 6];
        let tool = &frames.tool.position;
        for k in 0..self.path.min(MAX_JOINTS) {
            let axis = &frames.axis[k];
            let lever = cross(axis, &sub(tool, &frames.origin[k]));
            let (turn, slide) = (self.angle_per_q[k], self.slide_per_q[k]);
            let column = self.driver[k] & (MAX_JOINTS - 1);
            for i in 0..3 {
                rows[i][column] += turn * lever[i] + slide * axis[i];
                rows[i + 3][column] += turn * axis[i];
            }
        }
    }
}

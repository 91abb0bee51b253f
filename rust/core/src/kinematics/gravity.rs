//! Joint torques that hold the arm against gravity.

use super::forward::Frames;
use super::spatial::{Vec3, add, cross, dot, rotate, sub};
use crate::model::{Chain, Payload};
use crate::{JointVec, MAX_JOINTS};

/// Mass [kg] and first moment (mass times centre of mass [kg·m]) of the rigid group that each joint carries.
///
/// In the frame after the joint, see [`Frames::rotation`]; the group of the last joint before the tool includes the
/// payload.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Masses {
    /// Mass of each group [kg].
    pub mass: [f64; MAX_JOINTS],
    /// Mass times centre of mass of each group [kg·m], in the group's frame.
    pub moment: [[f64; 3]; MAX_JOINTS],
}

impl Chain {
    /// Masses of all groups with this payload at the tool, in place of any other payload.
    pub fn masses(&self, payload: Option<&Payload>) -> Masses {
        let mut masses = Masses { mass: self.mass, moment: self.moment };
        if let (Some(payload), Some(last)) = (payload, self.path.checked_sub(1)) {
            let centre = add(&self.tool.position, &rotate(&self.tool.rotation, &payload.com));
            if let (Some(mass), Some(moment)) = (masses.mass.get_mut(last), masses.moment.get_mut(last)) {
                *mass += payload.mass;
                *moment = add(moment, &centre.map(|c| c * payload.mass));
            }
        }
        masses
    }

    /// Torques [N·m, N for prismatic joints] that hold the arm at rest; `g` [m/s²] in the base.
    ///
    /// The gradient of the potential energy `−Σ mᵢ g·cᵢ`: walking from the tips inwards, each joint sees the mass `M`
    /// and the first moment `S` of all that it carries: `τ = −g·(z × (S − M o))`, for a prismatic joint `−M g·z`.
    pub fn gravity(&self, frames: &Frames, masses: &Masses, g: [f64; 3], out: &mut JointVec) {
        *out = [0.0; MAX_JOINTS];
        let mut mass = masses.mass;
        let mut moment: [Vec3; MAX_JOINTS] = [[0.0; 3]; MAX_JOINTS];
        for k in (0..self.total.min(MAX_JOINTS)).rev() {
            let (axis, origin) = (&frames.axis[k], &frames.origin[k]);
            let own = rotate(&frames.rotation[k], &masses.moment[k]);
            // Seen from the joint: S − M o, where M o of the joint's own group cancels.
            let beyond = mass[k] - masses.mass[k];
            let arm = sub(&add(&own, &moment[k]), &origin.map(|o| beyond * o));
            let torque = dot(&cross(axis, &arm), &g);
            let force = mass[k] * dot(axis, &g);
            out[self.driver[k] & (MAX_JOINTS - 1)] -= self.angle_per_q[k] * torque + self.slide_per_q[k] * force;
            let parent = self.parent[k];
            if parent < MAX_JOINTS {
                mass[parent] += mass[k];
                for i in 0..3 {
                    moment[parent][i] += moment[k][i] + own[i] + masses.mass[k] * origin[i];
                }
            }
        }
    }
}

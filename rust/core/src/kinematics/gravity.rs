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
        // What joints beside the path hang on each joint.
        let mut side = Load { mass: 0.0, moment: [0.0; 3] };
        let mut sides = [side; MAX_JOINTS];
        for k in (self.path..self.total.min(MAX_JOINTS)).rev() {
            let load = self.hold(k, frames, masses, g, sides[k], out);
            if let Some(parent) = sides.get_mut(self.parent[k]) {
                parent.add(&load);
            }
        }
        for k in (0..self.path.min(MAX_JOINTS)).rev() {
            side.add(&sides[k]);
            side = self.hold(k, frames, masses, g, side, out);
        }
    }

    /// Adds what joint `k` must hold, given what hangs on its group; what then hangs on the joint before.
    #[inline]
    fn hold(&self, k: usize, frames: &Frames, masses: &Masses, g: Vec3, beyond: Load, out: &mut JointVec) -> Load {
        let (axis, origin) = (&frames.axis[k], &frames.origin[k]);
        let own = rotate(&frames.rotation[k], &masses.moment[k]);
        // S − M o, where M o of the joint's own group cancels.
        let arm = sub(&add(&own, &beyond.moment), &origin.map(|o| beyond.mass * o));
        let mass = masses.mass[k] + beyond.mass;
        let torque = dot(&arm, &cross(&g, axis));
        let force = mass * dot(axis, &g);
        out[self.driver[k] & (MAX_JOINTS - 1)] -= self.angle_per_q[k] * torque + self.slide_per_q[k] * force;
        Load { mass, moment: add(&add(&own, &beyond.moment), &origin.map(|o| masses.mass[k] * o)) }
    }
}

/// Mass [kg] and first moment [kg·m] in base axes of everything beyond a joint.
#[derive(Clone, Copy)]
struct Load {
    mass: f64,
    moment: Vec3,
}

impl Load {
    #[inline]
    fn add(&mut self, other: &Self) {
        self.mass += other.mass;
        self.moment = add(&self.moment, &other.moment);
    }
}

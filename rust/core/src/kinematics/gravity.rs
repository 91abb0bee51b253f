//! Torques that hold the arm and its payload against gravity.

use super::forward::JointFrames;
use crate::math::simd::{BaselineF64, RealOps};
use crate::math::spatial::{Vec3, add, cross, dot, place, scale, splat, sub};
use crate::model::{Chain, Payload};
use crate::{JointVec, MAX_JOINTS};

/// Mass [kg] and first moment (mass times centre of mass [kg·m]) of the rigid group of links that each joint carries.
///
/// The group of the last joint before the tool includes the payload.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GroupMasses {
    /// Mass of each group [kg].
    pub mass: [f64; MAX_JOINTS],
    /// Mass times centre of mass of each group [kg·m], in the frame after its joint.
    pub moment: [[f64; 3]; MAX_JOINTS],
}

impl Chain {
    /// Returns the masses of all groups; `payload` is added to the last group before the tool.
    pub fn masses(&self, payload: Option<&Payload>) -> GroupMasses {
        let mut masses = GroupMasses { mass: self.mass, moment: self.moment };
        if let (Some(payload), Some(last)) = (payload, self.path.checked_sub(1)) {
            let centre = place::<BaselineF64>(&self.tool.rotation, &payload.com, &self.tool.position);
            if let (Some(mass), Some(moment)) = (masses.mass.get_mut(last), masses.moment.get_mut(last)) {
                *mass += payload.mass;
                *moment = add::<BaselineF64>(moment, &scale::<BaselineF64>(payload.mass, &centre));
            }
        }
        masses
    }

    /// Computes the torques [N·m, N for prismatic joints] that hold the arm at rest; `g` [m/s²] in the base.
    ///
    /// They are the gradient of the potential energy `−Σ mᵢ g·cᵢ` of masses mᵢ at cᵢ, from the tips to the base: a joint with
    /// origin `o` and axis `z` that carries the mass `M` with first moment `S` has the torque `τ = −g·(z × (S − M o))`,
    /// a prismatic joint the force `−M g·z`.
    pub fn gravity(&self, frames: &JointFrames, masses: &GroupMasses, g: [f64; 3], out: &mut JointVec) {
        self.gravity_by::<BaselineF64>(frames, masses, &g, out);
    }

    /// Computes [`Chain::gravity`] for one configuration or for several.
    #[inline(always)]
    pub(crate) fn gravity_by<A: RealOps>(
        &self,
        frames: &JointFrames<A::Real>,
        masses: &GroupMasses,
        g: &Vec3,
        out: &mut [A::Real; MAX_JOINTS],
    ) {
        for value in out.iter_mut() {
            *value = A::splat(0.0);
        }
        let g = splat::<A>(g);
        let massless = SubtreeMass { mass: 0.0, moment: [A::splat(0.0); 3] };
        let mut subtree = massless;
        if self.path == self.total {
            for k in (0..self.path.min(MAX_JOINTS)).rev() {
                subtree = self.joint_gravity::<A>(k, frames, masses, &g, &subtree, out);
            }
            return;
        }
        // Masses of the joints beside the path, added to the joint that carries them.
        let mut sides = [massless; MAX_JOINTS];
        for k in (self.path..self.total.min(MAX_JOINTS)).rev() {
            let load = self.joint_gravity::<A>(k, frames, masses, &g, &sides[k], out);
            if let Some(parent) = sides.get_mut(self.parent[k]) {
                *parent = parent.with::<A>(&load);
            }
        }
        for k in (0..self.path.min(MAX_JOINTS)).rev() {
            subtree = self.joint_gravity::<A>(k, frames, masses, &g, &subtree.with::<A>(&sides[k]), out);
        }
    }

    /// Adds the torque of joint `k`, which carries its rigid group and `subtree`, to `out`; returns the sum of both
    /// masses.
    #[inline(always)]
    fn joint_gravity<A: RealOps>(
        &self,
        k: usize,
        frames: &JointFrames<A::Real>,
        masses: &GroupMasses,
        g: &Vec3<A::Real>,
        subtree: &SubtreeMass<A::Real>,
        out: &mut [A::Real; MAX_JOINTS],
    ) -> SubtreeMass<A::Real> {
        let (axis, origin) = (&frames.axis[k], &frames.origin[k]);
        let moment = place::<A>(&frames.rotation[k], &splat::<A>(&masses.moment[k]), &subtree.moment);
        // S − M o. For the joint's own group, the contribution of the origin to S cancels with that to M o.
        let arm = sub::<A>(&moment, &scale::<A>(A::splat(subtree.mass), origin));
        let torque = dot::<A>(&arm, &cross::<A>(g, axis));
        let slot = &mut out[self.driver[k] & (MAX_JOINTS - 1)];
        *slot = A::fnma(A::splat(self.angle_per_q[k]), torque, *slot);
        let mass = masses.mass[k] + subtree.mass;
        if self.slides[k] {
            *slot = A::fnma(A::splat(self.slide_per_q[k] * mass), dot::<A>(axis, g), *slot);
        }
        SubtreeMass { mass, moment: add::<A>(&moment, &scale::<A>(A::splat(masses.mass[k]), origin)) }
    }
}

/// Mass [kg] and first moment [kg·m] about the base's origin, in base axes, of all groups beyond a joint.
#[derive(Clone, Copy)]
struct SubtreeMass<R> {
    mass: f64,
    moment: Vec3<R>,
}

impl<R: Copy> SubtreeMass<R> {
    #[inline(always)]
    fn with<A: RealOps<Real = R>>(&self, other: &Self) -> Self {
        Self { mass: self.mass + other.mass, moment: add::<A>(&self.moment, &other.moment) }
    }
}

//! Tool, Jacobian and holding torques at once, for the control step: what follows from the frames is done joints side by side.

use super::forward::{Frames, Visitor};
use super::gravity::Masses;
use super::spatial::{Mat3, Vec3, cross, dot, place, splat, sub};
use crate::law::inverse::load_rows;
use crate::model::Chain;
use crate::number::{Arithmetic, Joints, Lanes, Scalar};
use crate::pose::Pose;
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// What a control step sees of the arm.
#[derive(Clone, Copy)]
pub(crate) struct View<J: Lanes> {
    /// `base_from_tool`.
    pub(crate) tool: Pose<Scalar<J>>,
    /// Jacobian in base axes (6 × n).
    pub(crate) world: [J; MAX_AXES],
    /// Torques that hold the arm [N·m].
    pub(crate) holding: J,
}

/// Memory that a look at the arm works in; nothing of it outlives the look.
#[derive(Debug, Clone)]
pub(crate) struct LookScratch {
    frames: Frames,
    world: Rows,
    moment: [JointVec; 3],
    holding: JointVec,
}

impl LookScratch {
    pub(crate) fn new() -> Self {
        let zero = [0.0; MAX_JOINTS];
        Self { frames: Frames::default(), world: [zero; MAX_AXES], moment: [zero; 3], holding: zero }
    }
}

/// Origins, axes and the first moments of the groups' own masses in base axes, one row per component.
struct Columns<'a, A: Arithmetic<Real = f64>> {
    rows: &'a mut Rows,
    moment: &'a mut [JointVec; 3],
    masses: &'a Masses,
    number: std::marker::PhantomData<A>,
}

impl<A: Arithmetic<Real = f64>> Visitor<f64> for Columns<'_, A> {
    #[inline(always)]
    fn joint(&mut self, k: usize, rotation: &Mat3, origin: &Vec3) {
        let carried = place::<A>(rotation, &self.masses.moment[k], &[0.0; 3]);
        for i in 0..3 {
            self.rows[i][k] = origin[i];
            self.rows[i + 3][k] = rotation[i][2];
            self.moment[i][k] = carried[i];
        }
    }
}

impl Chain {
    /// Tool, Jacobian and, where `heavy`, holding torques of several configurations; `rows` are 0 behind the last joint.
    #[inline(always)]
    pub(crate) fn look_abreast<J: Lanes>(
        &self,
        q: J,
        masses: &Masses,
        g: &Vec3,
        heavy: bool,
        rows: &mut [[Scalar<J>; MAX_JOINTS]; MAX_AXES],
    ) -> View<J> {
        let (q, zero) = (q.array(), J::One::splat(0.0));
        let mut holding = [zero; MAX_JOINTS];
        let tool = if heavy {
            let mut frames = Frames::filled(zero);
            self.forward_by::<J::One>(&q, &mut frames);
            self.jacobian_by::<J::One>(&frames, rows);
            self.gravity_by::<J::One>(&frames, masses, g, &mut holding);
            frames.tool
        } else {
            self.kinematics_by::<J::One>(&q, rows)
        };
        let mut world = [J::splat(0.0); MAX_AXES];
        for r in 0..MAX_AXES {
            world[r] = J::of_joints(&rows[r]);
        }
        View { tool, world, holding: J::of_joints(&holding) }
    }

    /// Tool, Jacobian and holding torques at `q`; `g` [m/s²] in the base.
    #[inline(always)]
    pub(crate) fn look<J: Joints>(&self, q: J, masses: &Masses, g: &Vec3, scratch: &mut LookScratch) -> View<J> {
        let q = q.array();
        let LookScratch { frames, world, moment, holding } = scratch;
        if !(self.simple && self.path == self.total) {
            self.forward_by::<J::One>(&q, frames);
            self.jacobian_by::<J::One>(frames, world);
            self.gravity_by::<J::One>(frames, masses, g, holding);
            return View { tool: frames.tool, world: load_rows(world), holding: J::load(holding) };
        }
        let number = std::marker::PhantomData::<J::One>;
        let motions = self.motions::<J::One>(&q, self.path);
        let tool = self.walk::<J::One>(&motions, &mut Columns { rows: world, moment, masses, number });
        let [x, y, z, a, b, c] = load_rows::<J>(world);
        let (origin, axis) = ([x, y, z], [a, b, c]);
        let lever = cross::<J>(&axis, &sub::<J>(&splat::<J>(&tool.position), &origin));
        let world = [lever[0], lever[1], lever[2], a, b, c];

        // What hangs on each joint beyond its own group: mass, and first moment.
        let own = [J::load(&moment[0]), J::load(&moment[1]), J::load(&moment[2])];
        let mass = J::load(&masses.mass);
        let mut beyond = [[0.0; MAX_JOINTS]; 3];
        for i in 0..3 {
            J::fma(mass, origin[i], own[i]).store(&mut beyond[i]);
        }
        let (mut sum, mut mass_beyond) = ([0.0; 3], [0.0; MAX_JOINTS]);
        let mut total = 0.0;
        for k in (0..self.path.min(MAX_JOINTS)).rev() {
            mass_beyond[k] = total;
            total += masses.mass[k];
            for i in 0..3 {
                let all = sum[i] + beyond[i][k];
                beyond[i][k] = sum[i];
                sum[i] = all;
            }
        }
        // S − M o of [`Chain::gravity`], where M o of the joint's own group cancels.
        let (mut arm, mass_beyond) = (own, J::load(&mass_beyond));
        for i in 0..3 {
            arm[i] = J::fnma(mass_beyond, origin[i], own[i] + J::load(&beyond[i]));
        }
        let holding = -dot::<J>(&arm, &cross::<J>(&splat::<J>(g), &axis));
        View { tool, world, holding }
    }
}

//! What the present pose and settings can and cannot do, in numbers and in sentences.
//!
//! Off the hot path, but cheap enough to run beside the loop. Sides are named by the push: the first number of a pair is
//! for a push toward −, the second for one toward +.

mod check;
mod findings;
mod promise;
mod raise_soft;
mod stops;
mod words;

use crate::command::host_loss::HostLoss;
use crate::command::statics::static_force;
use crate::controller::{Controller, StepInput};
use crate::error::{Error, Result};
use crate::kinematics::Frames;
use crate::pose::COORDINATE_BOUND;
use crate::settings::Law;
use crate::task::axes::{AXIS_NAMES, OnDeviationLimit};
use crate::{JointVec, MAX_JOINTS};

pub use check::{FeasibilityReport, Issue};

use promise::Pose;
use stops::Way;

/// What one pose can do under the settings in force; one entry per task axis, or per joint.
///
/// Forces in N, for rotations N·m; all torques in N·m.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseReport {
    /// Names of the task's axes.
    pub axes: Vec<&'static str>,
    /// Names of the joints.
    pub joints: Vec<String>,
    /// Law in force.
    pub law: Law,
    /// Positions that this is about [rad].
    pub q: Vec<f64>,
    /// Torque limits in force there [N·m].
    pub torque_limit: Vec<f64>,
    /// The largest static force that these limits hold: `min_i (L_i + s_i g_i) / |a_i|`, `a = Jᵀd`. Negative: the arm
    /// cannot hold itself.
    pub static_force: Vec<[f64; 2]>,
    /// The same with all the torque that the servos have.
    pub capacity: Vec<[f64; 2]>,
    /// Force at which the axis gives way under the law, friction apart: at a small and at a large deviation, d⁻/(1 − η)
    /// and d⁺/(1 − η) or as far as a hand is followed, 0.15 m or 0.4 rad.
    pub gives_way: Vec<[[f64; 2]; 2]>,
    /// Whether the axis yields toward (−, +).
    pub yields: Vec<[bool; 2]>,
    /// Dry friction of the joints seen along the axis, `Σ_i |J⁺_ij| τ_f,i`: what a push at rest meets on top.
    pub friction: Vec<f64>,
    /// What the feed-forward leaves of it in steady motion: softer, the axis cannot even keep moving.
    pub friction_left: Vec<f64>,
    /// How firm the axis would be at strength 0, by the limits that the other axes ask of the same joints.
    pub coupling: Vec<[f64; 2]>,
    /// The other axis that asks for most of that.
    pub coupled_to: Vec<[Option<&'static str>; 2]>,
    /// Deviations d⁻/(1 − η), d⁺/(1 − η) between which the strength changes [m, rad].
    pub thresholds: Vec<[f64; 2]>,
    /// What the limit leaves beside gravity, for a joint pushed toward (−, +): `L − g`, `L + g` [N·m].
    pub gravity_margin: Vec<[f64; 2]>,
    /// Smallest singular value of the task rows, translations divided by the arm's length.
    pub sigma_min: f64,
    /// Largest over smallest singular value.
    pub condition: f64,
    /// σ₀ of the damping: poses with a σ_min far below are near singular.
    pub sigma_0: f64,
    /// Joints whose limit is at the servo's ceiling.
    pub saturated: Vec<bool>,
    /// Joints at a position limit that left the inverse kinematics.
    pub locked: Vec<bool>,
    /// The largest force that a hand at 25 mm/s or 0.067 rad/s meets on 0.15 m or 0.4 rad along the axis if the host dies
    /// now, from where the arm comes to rest, the gears' friction and damping included; ∞ where the arm cannot be moved so far: it is stretched out, or at stops.
    pub host_loss_force: Vec<[f64; 2]>,
    /// What the settings allow of that [N].
    pub max_host_loss_force: Option<f64>,
    /// Factor ≤ 1 on K_x, under law `impedance` on the stiffness, that delay and pose demand.
    pub gain_factor: f64,
    /// The same on the damping of law `impedance`.
    pub damping_factor: f64,
    /// Strength of an axis that does not yield; and the default, where soft or firm have raised it.
    pub hold: Vec<(f64, Option<f64>)>,
    /// How far the axis can be pushed, the others in place, until a joint meets its position limit [m, rad]; ∞ where none
    /// does on 0.15 m or 0.4 rad. Up to there the stop takes nothing of a push, from there on what it gets.
    pub stop_distance: Vec<[f64; 2]>,
    /// The joint that does.
    pub stop_joint: Vec<[Option<usize>; 2]>,
    /// How far that joint is from its limit now [rad or m]; ∞ for none.
    pub stop_room: Vec<[f64; 2]>,
    /// What the joints that are left rub along the axis there, in place of `friction`; ∞ where they cannot move it alone,
    /// so that the stop takes everything above the cap. 0 where no joint stops.
    pub stop_friction: Vec<[f64; 2]>,
    /// What the joints rub along the axis where they rub most on the way of a push, 0.15 m or 0.4 rad or as far as a stop
    /// [N, N·m]; many times `friction` where the way passes a singular pose.
    pub way_friction: Vec<[f64; 2]>,
    /// σ_min there.
    pub way_sigma: Vec<[f64; 2]>,
    /// How far the axis is pushed there [m, rad].
    pub way_distance: Vec<[f64; 2]>,
    /// Deviation [m, rad] beyond which the target of an axis waits or comes along; ∞ without such a limit and toward
    /// sides that yield.
    pub deviation_limit: Vec<[f64; 2]>,
    /// What the target does there.
    pub on_deviation_limit: Vec<OnDeviationLimit>,
    /// Joints that slide: theirs are metres.
    pub prismatic: Vec<bool>,
}

impl Controller {
    /// Report on the pose and the limits of the last step.
    ///
    /// # Errors
    /// [`Error::Config`] before the first step.
    pub fn report(&self) -> Result<PoseReport> {
        if self.memory.limit.is_none() {
            return Err(Error::config("report", "no step has been made yet: make one, or report on a given q"));
        }
        Ok(self.compose())
    }

    /// Report on the arm at rest on its target in `q` (n) [rad]. The controller stays as it is.
    ///
    /// # Errors
    /// As [`Controller::step`].
    ///
    /// ```
    /// # use pliant_core::{Controller, Model, ModelOptions, Servos, Settings};
    /// # fn main() -> pliant_core::Result<()> {
    /// # let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
    /// # let model = std::sync::Arc::new(Model::from_urdf_str(include_str!("../../robots/arm7.urdf"), &options)?);
    /// # let servos = Servos::new(vec![150.0], vec![10.7]);
    /// # let controller = Controller::new(model.clone(), Settings::default(), Some(servos))?;
    /// let report = controller.report_at(&[-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17])?; // [rad]
    /// assert_eq!(report.axes[1], "y");
    /// assert!(report.capacity[1][0] > 0.0); // [N], all that the servos can answer to a push toward −y
    /// assert!(report.to_string().contains("gives way"));
    /// # Ok(())
    /// # }
    /// ```
    pub fn report_at(&self, q: &[f64]) -> Result<PoseReport> {
        Ok(self.at_rest(q)?.compose())
    }

    /// A copy of this controller after its first step on its target in `q`.
    fn at_rest(&self, q: &[f64]) -> Result<Self> {
        let at = self.joints("q", q, COORDINATE_BOUND)?;
        let mut copy = self.clone();
        // At rest the goals have long arrived where they hold the arm.
        copy.settings.tracking.goal_slew = f64::INFINITY;
        copy.reset(q)?;
        let mut frames = Frames::default();
        copy.model().chain().forward(&at, &mut frames);
        copy.step(q, &frames.tool, &StepInput::default())?;
        Ok(copy)
    }

    fn compose(&self) -> PoseReport {
        let (plan, record) = (&self.plan, &self.record());
        let (k, n) = (plan.k, plan.n);
        let limit = self.limits_in_force();
        let pose = Pose::new(plan, self.settings(), record);
        let singular = record.singular_values(plan);
        let sigma_min = singular.iter().copied().fold(f64::INFINITY, f64::min);
        let friction = pose.friction();
        let mut report = PoseReport {
            axes: plan.axes.iter().map(|&axis| AXIS_NAMES[axis]).collect(),
            joints: self.model().joint_names().to_vec(),
            law: plan.law,
            q: record.q[..n].to_vec(),
            torque_limit: limit[..n].to_vec(),
            static_force: Vec::with_capacity(k),
            capacity: Vec::with_capacity(k),
            gives_way: Vec::with_capacity(k),
            yields: plan.rows[..k].iter().map(|row| row.yields.map(|w| w > 0.0)).collect(),
            friction: friction[..k].to_vec(),
            friction_left: friction[..k].iter().map(|f| f * pose.friction_share_left()).collect(),
            coupling: Vec::with_capacity(k),
            coupled_to: Vec::with_capacity(k),
            thresholds: plan.rows[..k]
                .iter()
                .map(|row| [row.soft_until, row.firm_from].map(|d| d / (1.0 - row.eta)))
                .collect(),
            gravity_margin: (0..n).map(|i| [limit[i] - record.gravity[i], limit[i] + record.gravity[i]]).collect(),
            sigma_min,
            condition: singular.max() / sigma_min,
            sigma_0: plan.damping.sigma_0,
            saturated: record.saturated[..n].to_vec(),
            locked: record.locked[..n].to_vec(),
            host_loss_force: Vec::with_capacity(k),
            max_host_loss_force: plan.max_host_loss_force,
            gain_factor: self.gain_factor(),
            damping_factor: self.damping_factor(),
            hold: plan.rows[..k].iter().map(|row| (row.hold, row.raised_from)).collect(),
            stop_distance: Vec::with_capacity(k),
            stop_joint: Vec::with_capacity(k),
            stop_room: Vec::with_capacity(k),
            stop_friction: Vec::with_capacity(k),
            way_friction: Vec::with_capacity(k),
            way_sigma: Vec::with_capacity(k),
            way_distance: Vec::with_capacity(k),
            deviation_limit: vec![[f64::INFINITY; 2]; k],
            on_deviation_limit: plan.axes.iter().map(|&axis| self.settings().axes[axis].on_deviation_limit).collect(),
            prismatic: self.model().prismatic().to_vec(),
        };
        for limit in &plan.deviation_limits {
            for (slot, _) in report.deviation_limit.iter_mut().zip(&plan.axes).filter(|(_, axis)| **axis == limit.axis)
            {
                *slot = limit.most;
            }
        }
        let mut rubs = [0.0; MAX_JOINTS];
        (0..n).for_each(|i| rubs[i] = plan.servos.friction_at_rest(i, record.gravity[i]));
        let mut frames = Frames::default();
        self.model().chain().forward(&record.q, &mut frames);
        let way = self.way(&frames, &rubs);
        let goal = spread(self.command.goal());
        let dead = self.dead(&frames, &goal, &limit, &rubs);
        let rest = dead.settled();
        for row in 0..k {
            let hold = |limit: &JointVec| {
                [-1.0, 1.0].map(|sign| static_force(&record.rows[row], sign, limit, &record.gravity, n))
            };
            report.static_force.push(hold(&limit));
            report.capacity.push(hold(&plan.servos.torque));
            report.gives_way.push([0, 1].map(|side| pose.gives_way(row, side)));
            let coupling = [0, 1].map(|side| pose.coupling(row, side));
            report.coupling.push(coupling.map(|(force, _)| force));
            report.coupled_to.push(coupling.map(|(_, with)| with.map(|other| AXIS_NAMES[plan.axes[other]])));
            report.host_loss_force.push([-1.0, 1.0].map(|sign| {
                let met = dead.largest(&rest, row, sign);
                if met.walled { f64::INFINITY } else { met.force }
            }));
            let pushes = [-1.0, 1.0].map(|sign| way.follow(row, sign));
            let stops = pushes.map(|push| push.stop);
            report.way_friction.push(pushes.map(|push| push.friction));
            report.way_sigma.push(pushes.map(|push| push.sigma));
            report.way_distance.push(pushes.map(|push| push.at));
            report.stop_distance.push(stops.map(|stop| stop.map_or(f64::INFINITY, |stop| stop.distance)));
            report.stop_joint.push(stops.map(|stop| stop.map(|stop| stop.joint)));
            report.stop_room.push(stops.map(|stop| stop.map_or(f64::INFINITY, |stop| stop.room)));
            report.stop_friction.push(stops.map(|stop| stop.map_or(0.0, |stop| stop.friction)));
        }
        report
    }

    /// The ways that pushes lead from the last step's pose; `friction` at rest [N·m].
    fn way<'a>(&'a self, frames: &Frames, friction: &'a JointVec) -> Way<'a> {
        let base_from_task = self.plan.base_from_task::<crate::number::Plain>(&frames.tool);
        Way { model: self.model(), plan: &self.plan, base_from_task, q: &self.record.q, friction }
    }

    /// The arm with its last command, should the host die now.
    fn dead<'a>(
        &'a self,
        frames: &Frames,
        goal: &'a JointVec,
        limit: &'a JointVec,
        friction: &'a JointVec,
    ) -> HostLoss<'a> {
        HostLoss {
            chain: self.model().chain(),
            plan: &self.plan,
            masses: &self.masses,
            gravity: self.gravity,
            base_from_task: self.plan.base_from_task::<crate::number::Plain>(&frames.tool),
            q: &self.record.q,
            goal,
            limit,
            friction,
        }
    }

    /// Limits of the last command.
    fn limits_in_force(&self) -> JointVec {
        spread(self.command.torque_limit())
    }
}

fn spread(values: &[f64]) -> JointVec {
    let mut out = [0.0; MAX_JOINTS];
    for (slot, value) in out.iter_mut().zip(values) {
        *slot = *value;
    }
    out
}

//! Largest force on a hand that pushes the arm after a host loss, when the servos keep their last goals and torque
//! limits.

use crate::kinematics::statics::yield_forces;
use crate::kinematics::{GroupMasses, Statics, task_row};
use crate::math::simd::{BaselineF64, RealOps, SimdLevel};
use crate::math::spatial::Mat3;
use crate::model::Chain;
use crate::params::{LimitRule, Params};
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Distance of a simulated push: along a translation [m], about a rotation [rad].
pub(crate) const TRAVEL: [f64; 2] = [0.15, 0.4];

/// Speed of the hand in a simulated push: along a translation [m/s], about a rotation [rad/s].
const SPEED: [f64; 2] = [0.025, 0.067];

/// Number of steps of a push if no joint needs shorter ones.
const STEPS: f64 = 50.0;

/// Maximum number of steps of a push.
const MAX_STEPS: usize = 120;

/// Largest motion of a joint in one step [rad; m if prismatic].
const MAX_JOINT_STEP: f64 = 0.04;

/// Lever of a joint below which it counts as at its dead centre and cannot follow the hand. For translations it is in
/// m/rad, divided by the length scale of [`Params::row_scale`] (1 for a reach of 0.71 m); for rotations it has no unit.
const DEAD_CENTRE: f64 = 0.015;

/// Maximum number of steps in the search for the equilibrium.
const MAX_SETTLING_STEPS: usize = 40;

/// Joint motion per step below which the equilibrium counts as reached [rad; m if prismatic].
const SETTLED: f64 = 1e-4;

/// Maximum number of Newton steps in the search for the force that moves the tool; two or three are usual.
const MAX_NEWTON_STEPS: usize = 20;

/// Number of bisection steps in the search for the share by which torque limits are reduced.
const HALVINGS: u32 = 6;

/// Arm after a host loss; its goals and torque limits stay constant.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HostLoss<'a> {
    pub(crate) simd_level: SimdLevel,
    pub(crate) chain: &'a Chain,
    pub(crate) params: &'a Params,
    pub(crate) masses: &'a GroupMasses,
    pub(crate) gravity: [f64; 3],
    pub(crate) base_from_task: [[f64; 3]; 3],
    pub(crate) q: &'a JointVec,
    pub(crate) goal: &'a JointVec,
    pub(crate) limit: &'a JointVec,
    /// Static dry friction of each joint [N·m].
    pub(crate) friction: &'a JointVec,
}

/// Result of a simulated push.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PushResult {
    /// Largest force of servos, gears and gravity on the hand along its path [N, N·m].
    pub(crate) force: f64,
    /// True if the push ends before its full distance because every joint that could yield is at a position limit or at
    /// its dead centre.
    pub(crate) blocked: bool,
}

/// Levers and torques of the arm at one point on the path of a push.
struct PushPoint {
    /// Motion of the tool in the direction of the push per joint motion [m/rad, 1].
    lever: JointVec,
    /// Gravity torques [N·m].
    holding: JointVec,
    /// Torque of the servos minus the gravity torque [N·m].
    pull: JointVec,
}

impl HostLoss<'_> {
    /// Returns the joint positions [rad] at which the arm comes to rest without a push; the present positions if k_p is
    /// unknown.
    pub(crate) fn equilibrium(&self) -> JointVec {
        let (n, mut q) = (self.params.n, *self.q);
        if !self.params.servos.has_kp {
            return q;
        }
        let (mut turn, mut stride) = ([0.0; MAX_JOINTS], [1.0; MAX_JOINTS]);
        for _ in 0..MAX_SETTLING_STEPS {
            let ([_, pull], _) = self.torques(&q);
            for i in 0..n {
                let servos = &self.params.servos;
                let excess = pull[i] - BaselineF64::clamp_abs(pull[i], self.friction[i]);
                // A joint that slips at its torque limit has no spring that determines its step: double it each time.
                let slips = (servos.kp[i] * (self.goal[i] - q[i])).abs() >= self.limit[i];
                stride[i] = if slips && excess * turn[i] > 0.0 { 2.0 * stride[i] } else { 1.0 };
                turn[i] = stride[i] * excess * servos.compliance[i];
            }
            q = self.advance(&q, &turn);
            if turn.iter().all(|x| x.abs() < SETTLED) {
                break;
            }
        }
        q
    }

    /// Returns the largest force on a hand that pushes the arm from `rest` along one task axis toward `sign` and leaves
    /// all other axes free.
    ///
    /// Each joint is a spring to its goal that slips at its torque limit L and has friction τ_f. A push F loads joint i
    /// with the torque `F a_i`, where a_i is its lever. The arm follows in small steps, each with the smallest F that
    /// moves the tool. First the springs stretch, until at joint i the push overcomes limit, friction, gravity torque g
    /// and damping d at the hand's speed v: `F = (L_i + τ_f,i + s_i g_i)/|a_i| + d_i v/a_i²` with `s_i = sign(a_i)`.
    /// From then on joint i turns alone until another joint is weaker. A joint at its position limit does not yield,
    /// but can turn back if the direction of its load changes along the path.
    pub(crate) fn max_push_force(&self, rest: &JointVec, row: usize, sign: f64) -> PushResult {
        let n = self.params.n;
        let kind = usize::from(self.params.per_axis[row].axis >= 3);
        let (step, end) = (TRAVEL[kind] / STEPS, TRAVEL[kind]);
        let (mut q, mut force, mut gone) = (*rest, f64::NEG_INFINITY, 0.0);
        for _ in 0..MAX_STEPS {
            let point = self.evaluate(&q, row, sign);
            let mut room = [0.0; MAX_JOINTS];
            (0..n).for_each(|i| room[i] = self.limit[i] + self.friction[i]);
            let mut yields = yield_forces(&point.lever, &room, &point.holding, n);
            for i in 0..n {
                let lever = point.lever[i];
                yields[i] += self.params.servos.drag[i] * SPEED[kind] / (lever * lever);
                if self.at_hard_stop(&q, i, lever) {
                    yields[i] = f64::INFINITY;
                }
            }
            let (mut max, mut weakest) = (f64::INFINITY, 0);
            for i in 0..n {
                if yields[i] < max {
                    (max, weakest) = (yields[i], i);
                }
            }
            if max.is_infinite() || point.lever[weakest].abs() * self.params.row_scale[row] < DEAD_CENTRE {
                // An arm that its own weight moves over the dead centre does not block the push.
                let result = force.max(0.0);
                return PushResult { force: result, blocked: max > result };
            }
            let (felt, mut turn) = self.spring(&q, &point, max, step);
            force = force.max(felt);
            if gone >= end {
                break;
            }
            let moved: f64 = (0..n).map(|i| point.lever[i] * turn[i]).sum();
            if moved < step {
                turn[weakest] += (step - moved) / point.lever[weakest];
            }
            let next = self.advance(&q, &turn);
            gone += (0..n).map(|i| point.lever[i] * (next[i] - q[i])).sum::<f64>();
            q = next;
        }
        PushResult { force, blocked: false }
    }

    /// Returns the smallest force, at most `max`, that moves the tool by `step` while the joints' springs stretch, and
    /// the joint displacements.
    fn spring(&self, q: &JointVec, point: &PushPoint, max: f64, step: f64) -> (f64, JointVec) {
        let n = self.params.n;
        if !self.params.servos.has_kp {
            return (max, [0.0; MAX_JOINTS]);
        }
        // Joint displacements under a force, the tool displacement, and its derivative with respect to the force.
        let stretch = |force: f64| {
            let (mut turn, mut moved, mut slope) = ([0.0; MAX_JOINTS], 0.0, 0.0);
            for i in 0..n {
                let (lever, compliance) = (point.lever[i], self.params.servos.compliance[i]);
                let torque = force * lever + point.pull[i];
                let free = torque - BaselineF64::clamp_abs(torque, self.friction[i]);
                if free == 0.0 || self.at_hard_stop(q, i, free) {
                    continue;
                }
                turn[i] = free * compliance;
                moved += lever * turn[i];
                slope += lever * lever * compliance;
            }
            (turn, moved, slope)
        };
        let (mut turn, mut moved, mut slope) = stretch(max);
        if moved < step {
            return (max, turn);
        }
        // The displacement is piecewise linear and non-decreasing in the force: Newton steps within bounds.
        let (mut low, mut high, mut force) = (max - 2.0 * max.abs() - 1.0, max, max);
        for _ in 0..MAX_NEWTON_STEPS {
            if moved < step {
                low = force;
            } else {
                high = force;
            }
            let next = force - (moved - step) / slope;
            force = if next > low && next < high { next } else { 0.5 * (low + high) };
            (turn, moved, slope) = stretch(force);
            if (moved - step).abs() < 1e-6 * step {
                break;
            }
        }
        (force, turn)
    }

    /// Returns true if joint i is at a position limit and the sign of `push` points outward.
    fn at_hard_stop(&self, q: &JointVec, i: usize, push: f64) -> bool {
        if push < 0.0 { q[i] <= self.params.lower[i] } else { q[i] >= self.params.upper[i] }
    }

    fn evaluate(&self, q: &JointVec, row: usize, sign: f64) -> PushPoint {
        let ([holding, pull], j_base) = self.torques(q);
        let lever = task_row(&j_base, &self.base_from_task, self.params.per_axis[row].axis);
        PushPoint { lever: lever.map(|a| sign * a), holding, pull }
    }

    /// Returns, at `q`: the gravity torques and the servo torques minus the gravity torques [N·m]; the Jacobian in base
    /// axes.
    fn torques(&self, q: &JointVec) -> ([JointVec; 2], Rows) {
        let mut j_base = [[0.0; MAX_JOINTS]; MAX_AXES];
        let rows = Some(&mut j_base);
        let statics = Statics { chain: self.chain, masses: self.masses, gravity: &self.gravity, q, rows };
        let holding = self.simd_level.dispatch_narrow(statics);
        let mut pull = [0.0; MAX_JOINTS];
        for i in 0..self.params.n.min(MAX_JOINTS) {
            let spring = self.params.servos.kp[i] * (self.goal[i] - q[i]);
            pull[i] = BaselineF64::clamp_abs(spring, self.limit[i]) - holding[i];
        }
        ([holding, pull], j_base)
    }

    /// Returns `q` after the displacement `turn` [rad], scaled so that no joint moves farther than [`MAX_JOINT_STEP`].
    /// Joints stop at their position limits; a joint beyond its limit does not move farther out.
    fn advance(&self, q: &JointVec, turn: &JointVec) -> JointVec {
        let longest = turn.iter().fold(0.0_f64, |max, x| max.max(x.abs()));
        let (share, mut next) = ((MAX_JOINT_STEP / longest).min(1.0), *q);
        for i in 0..self.params.n.min(MAX_JOINTS) {
            let (lower, upper) = (self.params.lower[i].min(q[i]), self.params.upper[i].max(q[i]));
            next[i] = (q[i] + share * turn[i]).max(lower).min(upper);
        }
        next
    }

    /// Returns the largest force on a hand along any translation of the task [N], with its task row and direction (±1).
    /// A push that ends at position limits or at a stretched arm counts up to its end. Stops at the first force above
    /// `enough`.
    pub(crate) fn worst_push(&self, enough: f64) -> (f64, usize, f64) {
        let (rest, mut worst) = (self.equilibrium(), (f64::NEG_INFINITY, 0, 1.0));
        for row in (0..self.params.k).filter(|&row| self.params.per_axis[row].axis < 3) {
            for sign in [-1.0, 1.0] {
                let force = self.max_push_force(&rest, row, sign).force;
                if force > worst.0 {
                    worst = (force, row, sign);
                }
                if force > enough {
                    return worst;
                }
            }
        }
        worst
    }

    /// Returns torque limits with which the force on a hand is at most `max` [N]. Removes a share of the `margin`; if
    /// that is not enough, all of it and a share of what exceeds `base`, the limits that hold the arm's weight [N·m].
    /// If even that is not enough, each limit is `base` or the present limit, whichever is smaller.
    fn limits_within(&self, max: f64, base: &JointVec, margin: &JointVec) -> JointVec {
        let is_within = |limit: &JointVec| HostLoss { limit, ..*self }.worst_push(max).0 <= max;
        if is_within(self.limit) {
            return *self.limit;
        }
        let least = each(|i| base[i].min(self.limit[i]));
        let bare = each(|i| (self.limit[i] - margin[i]).max(least[i]));
        let [from, to] = if is_within(&bare) {
            [bare, *self.limit]
        } else if is_within(&least) {
            [least, bare]
        } else {
            return least;
        };
        let between = |share: f64| each(|i| from[i] + share * (to[i] - from[i]));
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if is_within(&between(middle)) { low = middle } else { high = middle }
        }
        between(low)
    }
}

/// Arm at the end of a control step, for which torque limits are computed that bound the force on a hand after a host
/// loss.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HostLossBound<'a> {
    pub(crate) simd_level: SimdLevel,
    pub(crate) chain: &'a Chain,
    pub(crate) params: &'a Params,
    pub(crate) masses: &'a GroupMasses,
    pub(crate) gravity: &'a [f64; 3],
    /// Factor s_g on the gravity torques in the limits.
    pub(crate) gravity_scale: f64,
    pub(crate) base_from_task: Mat3,
    pub(crate) q: JointVec,
    pub(crate) goal: JointVec,
    pub(crate) limit: JointVec,
    /// Gravity torques [N·m].
    pub(crate) holding: JointVec,
    /// Gravity torques that the limits include [N·m]; 0 if the settings exclude gravity from the limits.
    pub(crate) in_limit: JointVec,
}

impl HostLossBound<'_> {
    /// Returns torque limits with which the force on a hand after a host loss is at most `max` [N], but not less than
    /// the arm's weight requires.
    #[cold]
    #[inline(never)]
    pub(crate) fn limits(&self, max: f64) -> JointVec {
        let (params, zero) = (self.params, [0.0; MAX_JOINTS]);
        let (mut friction, mut base) = (zero, zero);
        for i in 0..params.n {
            friction[i] = params.servos.friction_at_rest(i, self.holding[i]);
            base[i] = (self.gravity_scale * self.in_limit[i].abs()).max(params.min_torque_limit[i]);
        }
        let host_loss = HostLoss {
            simd_level: self.simd_level,
            chain: self.chain,
            params,
            masses: self.masses,
            gravity: *self.gravity,
            base_from_task: self.base_from_task,
            q: &self.q,
            goal: &self.goal,
            limit: &self.limit,
            friction: &friction,
        };
        let by_demand = params.law.by_force() && params.limits == LimitRule::Demand;
        host_loss.limits_within(max, &base, if by_demand { &params.limit_margin } else { &zero })
    }
}

fn each(of: impl Fn(usize) -> f64) -> JointVec {
    let mut out = [0.0; MAX_JOINTS];
    for (i, slot) in out.iter_mut().enumerate() {
        *slot = of(i);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::spatial::Mat3;
    use crate::model::{Model, ModelOptions};
    use crate::params::joint_space::JointSpaceStats;
    use crate::params::{Servos, Settings, Task};
    use crate::pose::Pose;

    /// One joint about y, whose tool is at 0.5 m along x and weighs 0.5 kg.
    const LEVER: &str = r#"<robot name="lever"><link name="base"/><link name="tool"><inertial><mass value="0.5"/>
        <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
        <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
        <limit lower="-2" upper="2" effort="8" velocity="3"/></joint><link name="arm"/>
        <joint name="out" type="fixed"><parent link="arm"/><child link="tool"/><origin xyz="0.5 0 0"/></joint></robot>"#;

    /// Returns the angle [rad] at which the lever comes to rest, and the servo torque minus the gravity torque there
    /// [N·m]. The joint has a stiffness of 100 N·m/rad and a friction of 0.2 N·m.
    fn rest_of_lever(goal: f64, limit: f64) -> (f64, f64) {
        const BASE_FROM_TASK: Mat3 = Pose::IDENTITY.rotation;
        let model = Model::from_urdf_str(LEVER, &ModelOptions::default()).unwrap();
        let settings = Settings { task: Task::parse("z").unwrap(), ..Settings::default() };
        let servos = Servos::new(vec![100.0], vec![8.0]);
        let params = Params::new(&model, &settings, Some(&servos), false, &mut JointSpaceStats::default()).unwrap();
        let masses = model.chain().masses(None);
        let [q, goal, limit, friction] =
            [0.0, goal, limit, 0.2].map(|value| each(|i| if i == 0 { value } else { 0.0 }));
        let host_loss = HostLoss {
            simd_level: SimdLevel::detect(),
            chain: model.chain(),
            params: &params,
            masses: &masses,
            gravity: model.gravity_vector(),
            base_from_task: BASE_FROM_TASK,
            q: &q,
            goal: &goal,
            limit: &limit,
            friction: &friction,
        };
        let rest = host_loss.equilibrium()[0];
        let spring = (100.0 * (goal[0] - rest)).clamp(-limit[0], limit[0]);
        (rest, spring - model.gravity(&[rest]).unwrap()[0])
    }

    #[test]
    fn the_arm_comes_to_rest_where_friction_holds_what_the_spring_leaves_of_the_weight() {
        for (goal, expected) in [(0.3, 0.2), (-0.2, -0.2)] {
            let (rest, pull) = rest_of_lever(goal, 8.0);
            assert!((pull - expected).abs() < 0.02, "{goal}: {rest} {pull}");
        }
    }

    #[test]
    fn a_joint_too_weak_for_its_weight_slips_until_limit_and_friction_hold_it() {
        // The weight is 2.45 N·m times the cosine of the angle.
        for (limit, expected) in [(1.0, 1.06), (2.2, 0.20), (0.1, 1.45)] {
            let (rest, pull) = rest_of_lever(0.0, limit);
            assert!((rest.abs() - expected).abs() < MAX_JOINT_STEP, "{limit}: {rest}");
            assert!(pull.abs() <= 0.2, "{limit}: {pull}");
        }
    }
}

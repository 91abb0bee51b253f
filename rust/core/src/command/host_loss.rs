//! Force on a hand after a loss of the host: the servos keep their last goals and limits.

use crate::kinematics::statics::yield_forces;
use crate::kinematics::{Frames, Masses};
use crate::math::simd::{Arithmetic, Plain};
use crate::math::spatial::Mat3;
use crate::model::Chain;
use crate::params::{LimitRule, Plan};
use crate::{JointVec, MAX_AXES, MAX_JOINTS};

/// Distance over which a hand is simulated [m, rad], and its speed [m/s, rad/s].
pub(crate) const TRAVEL: [f64; 2] = [0.15, 0.4];
const SPEED: [f64; 2] = [0.025, 0.067];

/// Steps on that path, maximum number of steps, and the longest step of one joint [rad or m].
const STEPS: f64 = 50.0;
const MOST_STEPS: usize = 120;
const LONGEST: f64 = 0.04;

/// Lever of the yielding joint, on an arm of 0.71 m [m] or about a rotation, below which it counts as at its dead
/// centre and does not follow the hand.
const DEAD_CENTRE: f64 = 0.015;

/// Maximum number of steps to equilibrium, and the rotation below which it is reached [rad or m].
const MOST_SETTLING: usize = 40;
const SETTLED: f64 = 1e-4;

/// Maximum number of Newton steps to the force between rest and yielding; two or three are usual.
const MOST_NEWTON: usize = 20;

/// Bisection steps for the share of the limits that is removed.
const HALVINGS: u32 = 6;

/// An arm whose goals and limits stay constant.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HostLoss<'a> {
    pub(crate) chain: &'a Chain,
    pub(crate) plan: &'a Plan,
    pub(crate) masses: &'a Masses,
    pub(crate) gravity: [f64; 3],
    pub(crate) base_from_task: [[f64; 3]; 3],
    pub(crate) q: &'a JointVec,
    pub(crate) goal: &'a JointVec,
    pub(crate) limit: &'a JointVec,
    /// Static dry friction [N·m].
    pub(crate) friction: &'a JointVec,
}

/// Largest force on a hand along its path.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Met {
    /// Force from servos, gears and gravity [N, N·m].
    pub(crate) force: f64,
    /// True if the path ends before the hand does: the joints that could yield are at a position limit or at their dead
    /// centre.
    pub(crate) walled: bool,
}

/// The arm at one point of the path.
struct Place {
    lever: JointVec,
    holding: JointVec,
    /// Torque of the servos minus the gravity torque [N·m].
    pull: JointVec,
}

impl HostLoss<'_> {
    /// Returns the equilibrium of the arm without a hand and with all goals reached.
    pub(crate) fn settled(&self) -> JointVec {
        let (n, mut q) = (self.plan.n, *self.q);
        if !self.plan.servos.has_kp {
            return q;
        }
        for _ in 0..MOST_SETTLING {
            let (_, [_, pull]) = self.torques(&q);
            let mut turn = [0.0; MAX_JOINTS];
            for i in 0..n {
                turn[i] = (pull[i] - Plain::clip(pull[i], self.friction[i])) * self.plan.servos.compliance[i];
            }
            q = self.turned(&q, &turn);
            if turn.iter().all(|x| x.abs() < SETTLED) {
                break;
            }
        }
        q
    }

    /// Returns the largest force along one task axis, toward `sign`, on a hand that pushes the arm at `rest` and leaves
    /// all other axes free.
    ///
    /// Each joint is a spring to its goal that slips at its torque limit and has friction. Under a push F joint i gets
    /// the torque `F a_i`. The arm follows in small steps, each with the smallest F that moves the tool. First the
    /// springs stretch, until the limit, friction and gravity torque of one joint are overcome, `F = (L_i + τ_f,i + s_i
    /// g_i)/|a_i| + d_i v/a_i²`. From there that joint turns alone until another joint is weaker. A joint at its
    /// position limit yields no farther; it turns back if the push changes its side along the path.
    pub(crate) fn largest(&self, rest: &JointVec, row: usize, sign: f64) -> Met {
        let n = self.plan.n;
        let kind = usize::from(self.plan.rows[row].axis >= 3);
        let (step, end) = (TRAVEL[kind] / STEPS, TRAVEL[kind]);
        let (mut q, mut force, mut gone) = (*rest, f64::NEG_INFINITY, 0.0);
        for _ in 0..MOST_STEPS {
            let place = self.at(&q, row, sign);
            let mut room = [0.0; MAX_JOINTS];
            (0..n).for_each(|i| room[i] = self.limit[i] + self.friction[i]);
            let mut yields = yield_forces(&place.lever, &room, &place.holding, n);
            for i in 0..n {
                let lever = place.lever[i];
                yields[i] += self.plan.servos.drag[i] * SPEED[kind] / (lever * lever);
                if self.stops(&q, i, lever) {
                    yields[i] = f64::INFINITY;
                }
            }
            let (mut most, mut weakest) = (f64::INFINITY, 0);
            for i in 0..n {
                if yields[i] < most {
                    (most, weakest) = (yields[i], i);
                }
            }
            if most.is_infinite() || place.lever[weakest].abs() * self.plan.row_scale[row] < DEAD_CENTRE {
                // An arm that tips over its dead centre by its own weight does not block.
                let met = force.max(0.0);
                return Met { force: met, walled: most > met };
            }
            let (felt, mut turn) = self.spring(&q, &place, most, step);
            force = force.max(felt);
            if gone >= end {
                break;
            }
            let moved: f64 = (0..n).map(|i| place.lever[i] * turn[i]).sum();
            if moved < step {
                turn[weakest] += (step - moved) / place.lever[weakest];
            }
            let next = self.turned(&q, &turn);
            gone += (0..n).map(|i| place.lever[i] * (next[i] - q[i])).sum::<f64>();
            q = next;
        }
        Met { force, walled: false }
    }

    /// Returns the smallest force, at most `most`, that moves the tool by `step` by stretching the joints' springs, and
    /// the joint displacements.
    fn spring(&self, q: &JointVec, place: &Place, most: f64, step: f64) -> (f64, JointVec) {
        let n = self.plan.n;
        if !self.plan.servos.has_kp {
            return (most, [0.0; MAX_JOINTS]);
        }
        // Joint displacements under a force, the tool displacement, and its derivative with respect to the force.
        let stretch = |force: f64| {
            let (mut turn, mut moved, mut slope) = ([0.0; MAX_JOINTS], 0.0, 0.0);
            for i in 0..n {
                let (lever, compliance) = (place.lever[i], self.plan.servos.compliance[i]);
                let torque = force * lever + place.pull[i];
                let free = torque - Plain::clip(torque, self.friction[i]);
                if free == 0.0 || self.stops(q, i, free) {
                    continue;
                }
                turn[i] = free * compliance;
                moved += lever * turn[i];
                slope += lever * lever * compliance;
            }
            (turn, moved, slope)
        };
        let (mut turn, mut moved, mut slope) = stretch(most);
        if moved < step {
            return (most, turn);
        }
        // Piecewise linear and non-decreasing: Newton steps, kept between bounds.
        let (mut low, mut high, mut force) = (most - 2.0 * most.abs() - 1.0, most, most);
        for _ in 0..MOST_NEWTON {
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

    /// Returns true if joint i is at its position limit and is pushed outward; `push` gives the sign.
    fn stops(&self, q: &JointVec, i: usize, push: f64) -> bool {
        if push < 0.0 { q[i] <= self.plan.lower[i] } else { q[i] >= self.plan.upper[i] }
    }

    fn at(&self, q: &JointVec, row: usize, sign: f64) -> Place {
        let (frames, [holding, pull]) = self.torques(q);
        let mut world = [[0.0; MAX_JOINTS]; MAX_AXES];
        self.chain.jacobian(&frames, &mut world);
        let lever = crate::kinematics::task_rows(&world, &self.base_from_task, &[self.plan.rows[row].axis])[0];
        Place { lever: lever.map(|a| sign * a), holding, pull }
    }

    /// Returns the gravity torques at `q`, and the servo torques minus these [N·m].
    fn torques(&self, q: &JointVec) -> (Frames, [JointVec; 2]) {
        let (mut frames, mut holding, mut pull) = (Frames::default(), [0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
        self.chain.forward(q, &mut frames);
        self.chain.gravity(&frames, self.masses, self.gravity, &mut holding);
        for i in 0..self.plan.n {
            let spring = self.plan.servos.kp[i] * (self.goal[i] - q[i]);
            pull[i] = Plain::clip(spring, self.limit[i]) - holding[i];
        }
        (frames, [holding, pull])
    }

    /// Returns `q` after a displacement, no joint by more than the longest step; a joint beyond its limits may stay
    /// there.
    fn turned(&self, q: &JointVec, turn: &JointVec) -> JointVec {
        let longest = turn.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        let (share, mut next) = ((LONGEST / longest).min(1.0), *q);
        for i in 0..self.plan.n {
            let (lower, upper) = (self.plan.lower[i].min(q[i]), self.plan.upper[i].max(q[i]));
            next[i] = (q[i] + share * turn[i]).max(lower).min(upper);
        }
        next
    }

    /// Returns the largest force on a hand along any translation of the task [N], without position limits and a
    /// stretched arm, its row and its side. Stops early above `enough`.
    pub(crate) fn worst(&self, enough: f64) -> (f64, usize, f64) {
        let (rest, mut worst) = (self.settled(), (f64::NEG_INFINITY, 0, 1.0));
        for row in (0..self.plan.k).filter(|&row| self.plan.rows[row].axis < 3) {
            for sign in [-1.0, 1.0] {
                let force = self.largest(&rest, row, sign).force;
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

    /// Returns the limits with which the force on a hand is at most `most` [N]: first removes part of the `margin`,
    /// then part of the excess over `base`, the gravity torques [N·m]. Returns `base` if that is not enough.
    fn spared(&self, most: f64, base: &JointVec, margin: &JointVec) -> JointVec {
        let keeps = |limit: &JointVec| HostLoss { limit, ..*self }.worst(most).0 <= most;
        if keeps(self.limit) {
            return *self.limit;
        }
        let least = each(|i| base[i].min(self.limit[i]));
        let bare = each(|i| (self.limit[i] - margin[i]).max(least[i]));
        let [from, to] = if keeps(&bare) {
            [bare, *self.limit]
        } else if keeps(&least) {
            [least, bare]
        } else {
            return least;
        };
        let between = |share: f64| each(|i| from[i] + share * (to[i] - from[i]));
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if keeps(&between(middle)) { low = middle } else { high = middle }
        }
        between(low)
    }
}

/// Arm at the end of a step, whose torque limits shall bound the force on a hand after a host loss.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HostLossBound<'a> {
    pub(crate) chain: &'a Chain,
    pub(crate) plan: &'a Plan,
    pub(crate) masses: &'a Masses,
    pub(crate) gravity: &'a [f64; 3],
    /// Factor s_g on gravity in the limits.
    pub(crate) gravity_scale: f64,
    pub(crate) base_from_task: Mat3,
    pub(crate) q: JointVec,
    pub(crate) goal: JointVec,
    pub(crate) limit: JointVec,
    /// Gravity torques, and their part in the limits [N·m].
    pub(crate) holding: JointVec,
    pub(crate) in_limit: JointVec,
}

impl HostLossBound<'_> {
    /// Returns the torque limits with which the arm pushes a hand with at most `most` [N] if the host dies now.
    #[cold]
    #[inline(never)]
    pub(crate) fn limits(&self, most: f64) -> JointVec {
        let (plan, nothing) = (self.plan, [0.0; MAX_JOINTS]);
        let (mut friction, mut base) = (nothing, nothing);
        for i in 0..plan.n {
            friction[i] = plan.servos.friction_at_rest(i, self.holding[i]);
            base[i] = (self.gravity_scale * self.in_limit[i].abs()).max(plan.floor[i]);
        }
        let dead = HostLoss {
            chain: self.chain,
            plan,
            masses: self.masses,
            gravity: *self.gravity,
            base_from_task: self.base_from_task,
            q: &self.q,
            goal: &self.goal,
            limit: &self.limit,
            friction: &friction,
        };
        let by_demand = plan.law.by_force() && plan.limits == LimitRule::Demand;
        dead.spared(most, &base, if by_demand { &plan.margin } else { &nothing })
    }
}

fn each(of: impl Fn(usize) -> f64) -> JointVec {
    let mut out = [0.0; MAX_JOINTS];
    for (i, slot) in out.iter_mut().enumerate() {
        *slot = of(i);
    }
    out
}

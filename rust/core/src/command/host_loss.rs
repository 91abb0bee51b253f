//! What a hand meets once the host has died: the servos keep their last goals and limits.

use crate::command::statics::yield_forces;
use crate::kinematics::{Frames, Masses};
use crate::model::Chain;
use crate::number::{Arithmetic, Plain};
use crate::plan::Plan;
use crate::{JointVec, MAX_AXES, MAX_JOINTS};

/// How far a hand is followed [m, rad], and how fast it goes [m/s, rad/s].
pub(crate) const TRAVEL: [f64; 2] = [0.15, 0.4];
const SPEED: [f64; 2] = [0.025, 0.067];

/// Steps on that way, most steps in all, and the longest of one joint [rad or m].
const STEPS: f64 = 50.0;
const MOST_STEPS: usize = 120;
const LONGEST: f64 = 0.04;

/// Lever of the joint that gives way, on an arm of 0.71 m [m] or about a rotation, below which it follows no hand: at its
/// dead centre.
const DEAD_CENTRE: f64 = 0.015;

/// Most steps in which an arm comes to rest by itself, and the turn below which it has [rad or m].
const MOST_SETTLING: usize = 40;
const SETTLED: f64 = 1e-4;

/// Most steps to the force between rest and giving way; two or three are enough.
const MOST_NEWTON: usize = 20;

/// An arm whose goals and limits stay as they are.
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
    /// Dry friction at rest [N·m].
    pub(crate) friction: &'a JointVec,
}

/// The most that a hand meets on its way.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Met {
    /// From servos, gears and weight [N, N·m].
    pub(crate) force: f64,
    /// Whether the way ends before the hand does: what could give way is at a position limit or at its dead centre.
    pub(crate) walled: bool,
}

/// The arm at one place of the way.
struct Place {
    lever: JointVec,
    holding: JointVec,
    /// Torque of the servos beside what holds the arm [N·m].
    pull: JointVec,
}

impl HostLoss<'_> {
    /// Where the arm comes to rest by itself: whoever leaned on it has let go, what was on its way has arrived.
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

    /// The largest force along one task axis, toward `sign`, of a hand that comes to the arm at `rest` and leaves all other
    /// axes free.
    ///
    /// Each joint is a spring to its goal, slips at its limit, and rubs. Pushed with F, joint i gets `F a_i`; the arm
    /// follows in small steps, each with the least F that makes the tool go on: springs are stretched until one joint's
    /// limit, friction and weight are overcome, `F = (L_i + τ_f,i + s_i g_i)/|a_i| + d_i v/a_i²`, from where that joint turns
    /// alone until another one is weaker. A joint at its position limit gives way no farther; it turns back from there where
    /// the way takes the push to its other side.
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
                // An arm that tips over its dead centre by its own weight is no wall.
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

    /// The least force, at most `most`, that moves the tool by `step` by stretching the joints' springs, and how they turn.
    fn spring(&self, q: &JointVec, place: &Place, most: f64, step: f64) -> (f64, JointVec) {
        let n = self.plan.n;
        if !self.plan.servos.has_kp {
            return (most, [0.0; MAX_JOINTS]);
        }
        // How the joints turn under a force, how far that moves the tool, and by how much more per newton.
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
        // Piecewise linear and never falling: Newton's steps, kept between bounds.
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

    /// Whether joint i stands at its position limit and is pushed farther, toward the sign of `push`.
    fn stops(&self, q: &JointVec, i: usize, push: f64) -> bool {
        if push < 0.0 { q[i] <= self.plan.lower[i] } else { q[i] >= self.plan.upper[i] }
    }

    fn at(&self, q: &JointVec, row: usize, sign: f64) -> Place {
        let (frames, [holding, pull]) = self.torques(q);
        let mut world = [[0.0; MAX_JOINTS]; MAX_AXES];
        self.chain.jacobian(&frames, &mut world);
        let lever = crate::task::rows(&world, &self.base_from_task, &[self.plan.rows[row].axis])[0];
        Place { lever: lever.map(|a| sign * a), holding, pull }
    }

    /// What holds the arm at `q`, and what its servos exert beside that [N·m].
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

    /// `q` after a turn, no joint by more than the longest step; one beyond its limits may stay there.
    fn turned(&self, q: &JointVec, turn: &JointVec) -> JointVec {
        let longest = turn.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        let (share, mut next) = ((LONGEST / longest).min(1.0), *q);
        for i in 0..self.plan.n {
            let (lower, upper) = (self.plan.lower[i].min(q[i]), self.plan.upper[i].max(q[i]));
            next[i] = (q[i] + share * turn[i]).max(lower).min(upper);
        }
        next
    }
}

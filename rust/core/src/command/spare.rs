//! Torque limits that bound the force on a hand if the host dies: `max_host_loss_force`.

use crate::JointVec;
use crate::MAX_JOINTS;
use crate::command::host_loss::HostLoss;

/// Bisection steps for the share of the limits that is removed.
const HALVINGS: u32 = 6;

impl HostLoss<'_> {
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
    pub(crate) fn spared(&self, most: f64, base: &JointVec, margin: &JointVec) -> JointVec {
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

fn each(of: impl Fn(usize) -> f64) -> JointVec {
    let mut out = [0.0; MAX_JOINTS];
    for (i, slot) in out.iter_mut().enumerate() {
        *slot = of(i);
    }
    out
}

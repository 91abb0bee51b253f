//! Gradual change from one payload to another while the arm is controlled.

use crate::kinematics::GroupMasses;
use crate::model::{Chain, Payload};

/// Duration of the ramp after a payload change [s], so that a wrong or mistimed payload does not make the arm jump.
const RAMP_TIME: f64 = 0.5;

/// Linear ramp from one payload to another.
#[derive(Debug, Clone, Copy)]
pub(super) struct PayloadRamp {
    /// Mass [kg] and first moment [kg·m] at the time of the change.
    from: MassMoment,
    /// Time since the change [s].
    elapsed: f64,
    /// Masses of the arm with the payload at the present point of the ramp.
    pub(super) masses: GroupMasses,
}

/// Mass [kg], then first moment (mass times centre of mass) [kg·m] of a payload in the tool frame. These numbers can be
/// interpolated, because gravity torques are linear in them.
pub(super) type MassMoment = [f64; 4];

/// Returns mass and first moment of a payload; zeros for no payload.
pub(super) fn mass_moment(payload: Option<&Payload>) -> MassMoment {
    payload.map_or([0.0; 4], |Payload { mass, com: [x, y, z] }| [*mass, mass * x, mass * y, mass * z])
}

impl PayloadRamp {
    /// Starts a ramp at mass and first moment `from`, with the present `masses` of the arm.
    pub(super) fn start(from: MassMoment, masses: &GroupMasses) -> Self {
        Self { from, elapsed: 0.0, masses: *masses }
    }

    /// Restores a ramp from the result of [`PayloadRamp::state`].
    pub(super) fn resume([mass, x, y, z, elapsed]: [f64; 5], masses: &GroupMasses) -> Self {
        Self { from: [mass, x, y, z], elapsed, masses: *masses }
    }

    /// Returns mass [kg] and first moment [kg·m] at the start of the ramp, and the time since then [s].
    pub(super) fn state(&self) -> [f64; 5] {
        let [mass, x, y, z] = self.from;
        [mass, x, y, z, self.elapsed]
    }

    /// Returns the present mass and first moment on the ramp toward the payload `to`.
    pub(super) fn current(&self, to: Option<&Payload>) -> MassMoment {
        let (to, share) = (mass_moment(to), (self.elapsed / RAMP_TIME).min(1.0));
        std::array::from_fn(|i| self.from[i] + share * (to[i] - self.from[i]))
    }

    /// Advances the ramp toward `to` by `dt` [s] and updates `masses`; returns false at the end of the ramp.
    #[cold]
    #[inline(never)]
    pub(super) fn advance(&mut self, dt: f64, chain: &Chain, to: Option<&Payload>) -> bool {
        self.elapsed += dt;
        if self.elapsed >= RAMP_TIME {
            return false;
        }
        let [mass, x, y, z] = self.current(to);
        let com = if mass > 0.0 { [x / mass, y / mass, z / mass] } else { [0.0; 3] };
        self.masses = chain.masses(Some(&Payload { mass, com }));
        true
    }
}

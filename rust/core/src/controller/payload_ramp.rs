//! Ramp from one payload to another while the arm is controlled.

use crate::controller::Controller;
use crate::kinematics::Masses;
use crate::model::Payload;

/// Ramp time [s] after a payload change, so that a wrong or mistimed payload moves the arm gradually.
const FADE: f64 = 0.5;

/// Ramp from one payload to another.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fade {
    /// Mass and first moment at the time of the change.
    from: Carries,
    /// Time since the change [s].
    since: f64,
    /// Current masses during the ramp.
    pub(super) masses: Masses,
}

/// Mass [kg] and first moment [kg·m] of a payload, tool frame. They are linear in the payload, so two can be
/// interpolated.
pub(super) type Carries = [f64; 4];

fn carries(payload: Option<&Payload>) -> Carries {
    payload.map_or([0.0; 4], |Payload { mass, com: [x, y, z] }| [*mass, mass * x, mass * y, mass * z])
}

impl Controller {
    /// Returns the masses that the steps use at present.
    pub(super) fn masses_in_force(&self) -> &Masses {
        match &self.fade {
            Some(fade) => &fade.masses,
            None => &self.masses,
        }
    }

    /// Sets another payload with these masses; without a ramp if no step has run yet.
    pub(super) fn take(&mut self, payload: Option<Payload>, masses: &Masses) {
        let (from, before) = (self.in_force(), *self.masses_in_force());
        (self.payload, self.masses) = (payload, *masses);
        self.fade = self.memory.started.then_some(Fade { from, since: 0.0, masses: before });
    }

    /// Returns a copy in which the ramp has ended.
    pub(crate) fn settled(&self) -> Self {
        Self { fade: None, ..self.clone() }
    }

    /// Returns mass and first moment that the steps use at present.
    fn in_force(&self) -> Carries {
        let to = carries(self.payload.as_ref());
        match &self.fade {
            Some(Fade { from, since, .. }) => {
                let share = (since / FADE).min(1.0);
                std::array::from_fn(|i| from[i] + share * (to[i] - from[i]))
            }
            None => to,
        }
    }

    /// Advances the ramp by `dt` [s] after a step.
    #[cold]
    #[inline(never)]
    pub(super) fn fade_on(&mut self, dt: f64) {
        let Some(fade) = &mut self.fade else { return };
        fade.since += dt;
        if fade.since >= FADE {
            self.fade = None;
            return;
        }
        let [mass, x, y, z] = self.in_force();
        let com = if mass > 0.0 { [x / mass, y / mass, z / mass] } else { [0.0; 3] };
        let masses = self.model.chain().masses(Some(&Payload { mass, com }));
        if let Some(fade) = &mut self.fade {
            fade.masses = masses;
        }
    }

    /// Returns the state of the ramp for [`Controller::resume_fade`]: mass and first moment at its start, time since
    /// [s].
    pub(super) fn fading(&self) -> Option<[f64; 5]> {
        self.fade.map(|Fade { from: [mass, x, y, z], since, .. }| [mass, x, y, z, since])
    }

    /// Resumes the ramp of another controller from its [`Controller::fading`].
    pub(super) fn resume_fade(&mut self, [mass, x, y, z, since]: [f64; 5]) {
        self.fade = Some(Fade { from: [mass, x, y, z], since, masses: self.masses });
        self.fade_on(0.0);
    }
}

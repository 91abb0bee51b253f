//! Another payload while the arm is controlled: it comes into force little by little.

use crate::controller::Controller;
use crate::kinematics::Masses;
use crate::model::Payload;

/// Time [s] until another payload is in force. One that is told too early, too late or wrongly moves the arm by what it is
/// wrong; this is how long it takes to.
const FADE: f64 = 0.5;

/// From one payload to another.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fade {
    /// What was in force when the other was told.
    from: Carries,
    /// Time since then [s].
    since: f64,
    /// What steps reckon with meanwhile.
    pub(super) masses: Masses,
}

/// Mass [kg] and first moment [kg·m] of a payload, tool frame: of two payloads they may be mixed.
pub(super) type Carries = [f64; 4];

fn carries(payload: Option<&Payload>) -> Carries {
    payload.map_or([0.0; 4], |Payload { mass, com: [x, y, z] }| [*mass, mass * x, mass * y, mass * z])
}

impl Controller {
    /// What the steps reckon with.
    pub(super) fn masses_in_force(&self) -> &Masses {
        match &self.fade {
            Some(fade) => &fade.masses,
            None => &self.masses,
        }
    }

    /// Takes another payload, whose masses these are: at once where nothing is controlled yet.
    pub(super) fn take(&mut self, payload: Option<Payload>, masses: &Masses) {
        let (from, before) = (self.in_force(), *self.masses_in_force());
        (self.payload, self.masses) = (payload, *masses);
        self.fade = self.memory.started.then_some(Fade { from, since: 0.0, masses: before });
    }

    /// A copy in which the last payload is in force.
    pub(crate) fn settled(&self) -> Self {
        Self { fade: None, ..self.clone() }
    }

    /// The payload that the steps reckon with.
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

    /// After a step of `dt` [s]: what the next one reckons with.
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

    /// What [`Controller::resume_fade`] takes: what was in force, and the time since [s].
    pub(super) fn fading(&self) -> Option<[f64; 5]> {
        self.fade.map(|Fade { from: [mass, x, y, z], since, .. }| [mass, x, y, z, since])
    }

    /// Goes on where another controller was with [`Controller::fading`].
    pub(super) fn resume_fade(&mut self, [mass, x, y, z, since]: [f64; 5]) {
        self.fade = Some(Fade { from: [mass, x, y, z], since, masses: self.masses });
        self.fade_on(0.0);
    }
}

//! Optional arguments of a control step: `dt`, `dq`, `twist`, `gradient`.

use pliant_core::{AxisVec, JointVec, StepInput};
use pyo3::prelude::*;

use crate::error::wrong_type;
use crate::read::{array_into, joints, number};

/// Expected value of a time, for error messages.
pub(crate) const SECONDS: &str = "a number [s]";

/// Optional arguments of a control step as numbers; `None` for those not given.
#[derive(Default)]
pub(crate) struct Extras {
    pub(crate) dt: Option<f64>,
    dq: Option<JointVec>,
    twist: Option<AxisVec>,
    gradient: Option<JointVec>,
}

impl Extras {
    /// Reads the given arguments into `self`; returning the mostly empty struct by value would copy it.
    #[inline]
    pub(crate) fn read(
        &mut self,
        n: usize,
        dt: Option<&Bound<'_, PyAny>>,
        dq: Option<&Bound<'_, PyAny>>,
        twist: Option<&Bound<'_, PyAny>>,
        gradient: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        if let Some(dt) = dt {
            self.dt = Some(number(dt).ok_or_else(|| wrong_type("dt", SECONDS, dt))?);
        }
        if let Some(dq) = dq {
            self.dq = Some(joints("dq", dq, n)?);
        }
        if let Some(twist) = twist {
            let mut six = [0.0; 6];
            array_into("twist", twist, &[6], &mut six)?;
            self.twist = Some(six);
        }
        if let Some(gradient) = gradient {
            self.gradient = Some(joints("gradient", gradient, n)?);
        }
        Ok(())
    }

    #[inline]
    pub(crate) fn input(&self, n: usize) -> StepInput<'_> {
        StepInput {
            dt: self.dt,
            dq: self.dq.as_ref().map(|dq| &dq[..n]),
            twist: self.twist.as_ref(),
            gradient: self.gradient.as_ref().map(|gradient| &gradient[..n]),
            posture: None,
        }
    }
}

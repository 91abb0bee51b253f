//! Python classes `Link`, `Joint`, `Inertial` and `Mimic`: the complete tree of the robot, for simulators.

use pliant_core::model;
use pliant_core::model::JointKind;
use pyo3::prelude::*;

use crate::ndarray::Array;
use crate::pose::Pose;

#[doc = stub!(Inertial)]
#[pyclass(module = "pliant.model", frozen, get_all)]
#[derive(Debug, Clone)]
pub(crate) struct Inertial {
    #[doc = stub!(Inertial.mass)]
    mass: f64,
    #[doc = stub!(Inertial.com)]
    com: Array,
    #[doc = stub!(Inertial.rotation)]
    rotation: Array,
    #[doc = stub!(Inertial.inertia)]
    inertia: Array,
}

impl From<&model::Inertial> for Inertial {
    fn from(core: &model::Inertial) -> Self {
        Self {
            mass: core.mass,
            com: Array::vector(&core.com),
            rotation: Array::rows(&core.rotation),
            inertia: Array::rows(&core.inertia),
        }
    }
}

#[pymethods]
impl Inertial {
    fn __repr__(&self) -> String {
        format!("<Inertial of {} kg>", self.mass)
    }
}

#[doc = stub!(Link)]
#[pyclass(module = "pliant.model", frozen, get_all)]
#[derive(Debug, Clone)]
pub(crate) struct Link {
    #[doc = stub!(Link.name)]
    name: String,
    #[doc = stub!(Link.parent_joint)]
    parent_joint: Option<usize>,
    #[doc = stub!(Link.inertial)]
    inertial: Option<Inertial>,
}

impl From<&model::Link> for Link {
    fn from(core: &model::Link) -> Self {
        let inertial = core.inertial.as_ref().map(Inertial::from);
        Self { name: core.name.clone(), parent_joint: core.parent_joint, inertial }
    }
}

#[pymethods]
impl Link {
    fn __repr__(&self) -> String {
        format!("<Link '{}'>", self.name)
    }
}

#[doc = stub!(Mimic)]
#[pyclass(module = "pliant.model", frozen, get_all)]
#[derive(Debug, Clone)]
pub(crate) struct Mimic {
    #[doc = stub!(Mimic.joint)]
    joint: usize,
    #[doc = stub!(Mimic.multiplier)]
    multiplier: f64,
    #[doc = stub!(Mimic.offset)]
    offset: f64,
}

#[pymethods]
impl Mimic {
    fn __repr__(&self) -> String {
        format!("<Mimic of joint {}: {} q + {}>", self.joint, self.multiplier, self.offset)
    }
}

#[doc = stub!(Joint)]
#[pyclass(module = "pliant.model", frozen, get_all)]
#[derive(Debug, Clone)]
pub(crate) struct Joint {
    #[doc = stub!(Joint.name)]
    name: String,
    #[doc = stub!(Joint.kind)]
    kind: &'static str,
    #[doc = stub!(Joint.parent)]
    parent: usize,
    #[doc = stub!(Joint.child)]
    child: usize,
    #[doc = stub!(Joint.origin)]
    origin: Pose,
    #[doc = stub!(Joint.axis)]
    axis: Array,
    #[doc = stub!(Joint.lower)]
    lower: Option<f64>,
    #[doc = stub!(Joint.upper)]
    upper: Option<f64>,
    #[doc = stub!(Joint.velocity)]
    velocity: Option<f64>,
    #[doc = stub!(Joint.effort)]
    effort: Option<f64>,
    #[doc = stub!(Joint.damping)]
    damping: Option<f64>,
    #[doc = stub!(Joint.friction)]
    friction: Option<f64>,
    #[doc = stub!(Joint.mimic)]
    mimic: Option<Mimic>,
    #[doc = stub!(Joint.q_index)]
    q_index: Option<usize>,
    #[doc = stub!(Joint.locked_at)]
    locked_at: Option<f64>,
}

impl From<&model::Joint> for Joint {
    fn from(core: &model::Joint) -> Self {
        let mimic = core.mimic.map(|model::Mimic { joint, multiplier, offset }| Mimic { joint, multiplier, offset });
        Self {
            name: core.name.clone(),
            kind: match core.kind {
                JointKind::Revolute => "revolute",
                JointKind::Continuous => "continuous",
                JointKind::Prismatic => "prismatic",
                JointKind::Fixed => "fixed",
                JointKind::Other => "other",
            },
            parent: core.parent,
            child: core.child,
            origin: Pose(core.origin),
            axis: Array::vector(&core.axis),
            lower: core.lower,
            upper: core.upper,
            velocity: core.velocity,
            effort: core.effort,
            damping: core.damping,
            friction: core.friction,
            mimic,
            q_index: core.q_index,
            locked_at: core.locked_at,
        }
    }
}

#[pymethods]
impl Joint {
    fn __repr__(&self) -> String {
        format!("<Joint '{}' ({})>", self.name, self.kind)
    }
}

//! `Link`, `Joint`, `Inertial`, `Mimic`: the complete robot tree, for simulators.

use pliant_core::model;
use pliant_core::model::JointKind;
use pyo3::prelude::*;

use crate::convert::new_array;
use crate::pose::Pose;

#[pyclass(module = "pliant.model", frozen)]
#[derive(Debug, Clone)]
pub(crate) struct Inertial(model::Inertial);

#[pymethods]
impl Inertial {
    #[getter]
    fn mass(&self) -> f64 {
        self.0.mass
    }

    #[getter]
    fn com<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[3], &self.0.com)
    }

    #[getter]
    fn rotation<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[3, 3], self.0.rotation.as_flattened())
    }

    #[getter]
    fn inertia<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[3, 3], self.0.inertia.as_flattened())
    }

    fn __repr__(&self) -> String {
        format!("<Inertial of {} kg>", self.0.mass)
    }
}

#[pyclass(module = "pliant.model", frozen)]
#[derive(Debug, Clone)]
pub(crate) struct Link(pub(crate) model::Link);

#[pymethods]
impl Link {
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    #[getter]
    fn parent_joint(&self) -> Option<usize> {
        self.0.parent_joint
    }

    #[getter]
    fn inertial(&self) -> Option<Inertial> {
        self.0.inertial.map(Inertial)
    }

    fn __repr__(&self) -> String {
        format!("<Link '{}'>", self.0.name)
    }
}

#[pyclass(module = "pliant.model", frozen)]
#[derive(Debug, Clone)]
pub(crate) struct Mimic(model::Mimic);

#[pymethods]
impl Mimic {
    #[getter]
    fn joint(&self) -> usize {
        self.0.joint
    }

    #[getter]
    fn multiplier(&self) -> f64 {
        self.0.multiplier
    }

    #[getter]
    fn offset(&self) -> f64 {
        self.0.offset
    }

    fn __repr__(&self) -> String {
        format!("<Mimic of joint {}: {} q + {}>", self.0.joint, self.0.multiplier, self.0.offset)
    }
}

#[pyclass(module = "pliant.model", frozen)]
#[derive(Debug, Clone)]
pub(crate) struct Joint(pub(crate) model::Joint);

#[pymethods]
impl Joint {
    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    #[getter]
    fn kind(&self) -> &'static str {
        match self.0.kind {
            JointKind::Revolute => "revolute",
            JointKind::Continuous => "continuous",
            JointKind::Prismatic => "prismatic",
            JointKind::Fixed => "fixed",
            JointKind::Other => "other",
        }
    }

    #[getter]
    fn parent(&self) -> usize {
        self.0.parent
    }

    #[getter]
    fn child(&self) -> usize {
        self.0.child
    }

    #[getter]
    fn origin(&self) -> Pose {
        Pose(self.0.origin)
    }

    #[getter]
    fn axis<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[3], &self.0.axis)
    }

    #[getter]
    fn lower(&self) -> Option<f64> {
        self.0.lower
    }

    #[getter]
    fn upper(&self) -> Option<f64> {
        self.0.upper
    }

    #[getter]
    fn velocity(&self) -> Option<f64> {
        self.0.velocity
    }

    #[getter]
    fn effort(&self) -> Option<f64> {
        self.0.effort
    }

    #[getter]
    fn damping(&self) -> Option<f64> {
        self.0.damping
    }

    #[getter]
    fn friction(&self) -> Option<f64> {
        self.0.friction
    }

    #[getter]
    fn mimic(&self) -> Option<Mimic> {
        self.0.mimic.map(Mimic)
    }

    #[getter]
    fn q_index(&self) -> Option<usize> {
        self.0.q_index
    }

    #[getter]
    fn locked_at(&self) -> Option<f64> {
        self.0.locked_at
    }

    fn __repr__(&self) -> String {
        format!("<Joint '{}' ({})>", self.0.name, self.kind())
    }
}

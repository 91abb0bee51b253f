//! `PoseReport`, `FeasibilityReport` and `Issue`.

use numpy::PyArray1;
use pliant_core::analysis;
use pliant_core::{
    Controller as CoreController, FeasibilityReport as CoreCheck, Issue as CoreFinding, Model as CoreModel,
    Pose as CorePose, PoseReport as CoreReport,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::arguments;
use crate::controller::Controller;
use crate::convert::new_array;
use crate::error::{OrRaise, shape};
use crate::model::Model;
use crate::read::{joints, numbers, pose_of_object};
use crate::servos::Servos;
use crate::settings::Settings;

#[doc = stub!(PoseReport)]
#[pyclass(module = "pliant.feasibility", frozen, eq)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PoseReport(pub(crate) CoreReport);

/// Defines attributes from fields of the core's report.
macro_rules! attributes {
    (vectors: $($vector:ident),*; pairs: $($pair:ident),*; flags: $($flag:ident),*; numbers: $($number:ident),*;) => {
        #[pymethods]
        impl PoseReport {
            $(#[doc = stub!(PoseReport.$vector)]
            #[getter]
            fn $vector<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
                new_array(py, &[self.0.$vector.len()], &self.0.$vector)
            })*

            $(#[doc = stub!(PoseReport.$pair)]
            #[getter]
            fn $pair<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
                pairs(py, &self.0.$pair)
            })*

            $(#[doc = stub!(PoseReport.$flag)]
            #[getter]
            fn $flag<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
                PyArray1::from_slice(py, &self.0.$flag).into_any()
            })*

            $(#[doc = stub!(PoseReport.$number)]
            #[getter]
            fn $number(&self) -> f64 {
                self.0.$number
            })*

            #[doc = stub!(PoseReport.to_dict)]
            fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
                let (out, report) = (PyDict::new(py), &self.0);
                out.set_item("axes", &report.axes)?;
                out.set_item("joints", &report.joints)?;
                $(out.set_item(stringify!($vector), &report.$vector)?;)*
                $(out.set_item(stringify!($pair), &report.$pair)?;)*
                $(out.set_item(stringify!($flag), &report.$flag)?;)*
                $(out.set_item(stringify!($number), report.$number)?;)*
                out.set_item("gives_way", &report.gives_way)?;
                out.set_item("max_host_loss_force", report.max_host_loss_force)?;
                out.set_item("yields", &report.yields)?;
                out.set_item("coupled_to", &report.coupled_to)?;
                out.set_item("stop_joint", stop_joints(report))?;
                out.set_item("sentences", report.summary())?;
                Ok(out)
            }
        }
    };
}

attributes! {
    vectors: q, torque_limit, friction, friction_left;
    pairs: static_force, capacity, coupling, thresholds, gravity_margin, host_loss_force, stop_distance, stop_room, stop_friction, way_friction, way_sigma, way_distance, deviation_limit;
    flags: saturated, locked;
    numbers: sigma_min, condition, sigma_0, gain_factor, damping_factor;
}

#[pymethods]
impl PoseReport {
    #[doc = stub!(PoseReport.gives_way)]
    #[getter]
    fn gives_way<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[self.0.gives_way.len(), 2, 2], self.0.gives_way.as_flattened().as_flattened())
    }

    #[doc = stub!(PoseReport.axes)]
    #[getter]
    fn axes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, &self.0.axes)
    }

    #[doc = stub!(PoseReport.joints)]
    #[getter]
    fn joints<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, &self.0.joints)
    }

    #[doc = stub!(PoseReport.max_host_loss_force)]
    #[getter]
    fn max_host_loss_force(&self) -> Option<f64> {
        self.0.max_host_loss_force
    }

    #[doc = stub!(PoseReport.yields)]
    #[getter]
    fn yields(&self) -> Vec<(bool, bool)> {
        self.0.yields.iter().map(|&[minus, plus]| (minus, plus)).collect()
    }

    #[doc = stub!(PoseReport.coupled_to)]
    #[getter]
    fn coupled_to(&self) -> Vec<(Option<&'static str>, Option<&'static str>)> {
        self.0.coupled_to.iter().map(|&[minus, plus]| (minus, plus)).collect()
    }

    #[doc = stub!(PoseReport.stop_joint)]
    #[getter]
    fn stop_joint(&self) -> Vec<(Option<&str>, Option<&str>)> {
        stop_joints(&self.0)
    }

    #[doc = stub!(PoseReport.summary)]
    fn summary(&self) -> Vec<String> {
        self.0.summary()
    }

    fn __str__(&self) -> String {
        self.0.to_string()
    }

    fn __repr__(&self) -> String {
        format!("<PoseReport: axes {}; {} joints>", self.0.axes.join(" "), self.0.joints.len())
    }
}

/// Returns the names of the joints that stop a push toward (−, +).
fn stop_joints(report: &CoreReport) -> Vec<(Option<&str>, Option<&str>)> {
    let name = |joint: Option<usize>| joint.map(|joint| report.joints[joint].as_str());
    report.stop_joint.iter().map(|&[minus, plus]| (name(minus), name(plus))).collect()
}

fn pairs<'py>(py: Python<'py>, values: &[[f64; 2]]) -> Bound<'py, PyAny> {
    new_array(py, &[values.len(), 2], values.as_flattened())
}

#[doc = stub!(Issue)]
#[pyclass(module = "pliant.feasibility", frozen, eq)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Issue(CoreFinding);

#[pymethods]
impl Issue {
    #[doc = stub!(Issue.pose)]
    #[getter]
    fn pose(&self) -> usize {
        self.0.pose
    }

    #[doc = stub!(Issue.about)]
    #[getter]
    fn about(&self) -> &str {
        &self.0.about
    }

    #[doc = stub!(Issue.required)]
    #[getter]
    fn required(&self) -> bool {
        self.0.required
    }

    #[doc = stub!(Issue.reason)]
    #[getter]
    fn reason(&self) -> &str {
        &self.0.reason
    }

    #[doc = stub!(Issue.setting)]
    #[getter]
    fn setting(&self) -> Option<&str> {
        self.0.setting.as_deref()
    }

    #[doc = stub!(Issue.value)]
    #[getter]
    fn value(&self) -> Option<f64> {
        self.0.value
    }

    fn __repr__(&self) -> String {
        let weight = if self.0.required { "required" } else { "note" };
        format!("<Issue ({weight}): {} at pose {}: {}>", self.0.about, self.0.pose, self.0.reason)
    }
}

#[doc = stub!(FeasibilityReport)]
#[pyclass(module = "pliant.feasibility", frozen, eq)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FeasibilityReport(CoreCheck);

#[pymethods]
impl FeasibilityReport {
    #[doc = stub!(FeasibilityReport.achievable)]
    #[getter]
    fn achievable(&self) -> bool {
        self.0.achievable
    }

    #[doc = stub!(FeasibilityReport.poses)]
    #[getter]
    fn poses(&self) -> usize {
        self.0.poses
    }

    #[doc = stub!(FeasibilityReport.findings)]
    #[getter]
    fn findings<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let found: PyResult<Vec<_>> =
            self.0.findings.iter().map(|finding| Bound::new(py, Issue(finding.clone()))).collect();
        PyTuple::new(py, found?)
    }

    #[doc = stub!(FeasibilityReport.axes)]
    #[getter]
    fn axes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, &self.0.axes)
    }

    #[doc = stub!(FeasibilityReport.capacity)]
    #[getter]
    fn capacity<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        pairs(py, &self.0.capacity)
    }

    #[doc = stub!(FeasibilityReport.worst_pose)]
    #[getter]
    fn worst_pose(&self) -> Vec<(usize, usize)> {
        self.0.worst_pose.iter().map(|&[minus, plus]| (minus, plus)).collect()
    }

    #[doc = stub!(FeasibilityReport.friction_left)]
    #[getter]
    fn friction_left<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[self.0.friction_left.len()], &self.0.friction_left)
    }

    #[doc = stub!(FeasibilityReport.stop_distance)]
    #[getter]
    fn stop_distance<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        pairs(py, &self.0.stop_distance)
    }

    #[doc = stub!(FeasibilityReport.sigma_min)]
    #[getter]
    fn sigma_min(&self) -> f64 {
        self.0.sigma_min
    }

    #[doc = stub!(FeasibilityReport.sigma_pose)]
    #[getter]
    fn sigma_pose(&self) -> usize {
        self.0.sigma_pose
    }

    #[doc = stub!(FeasibilityReport.way_sigma)]
    #[getter]
    fn way_sigma<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        pairs(py, &self.0.way_sigma)
    }

    fn __bool__(&self) -> bool {
        self.0.achievable
    }

    fn __str__(&self) -> String {
        self.0.to_string()
    }

    fn __repr__(&self) -> String {
        let verdict = if self.0.achievable { "achievable" } else { "not achievable" };
        format!("<FeasibilityReport: {verdict}, {} poses, {} findings>", self.0.poses, self.0.findings.len())
    }
}

/// Argument of a check.
enum Checked {
    Pose(CorePose),
    Path(Vec<Vec<f64>>),
}

/// Reads one posture (n) or several (N, n).
pub(crate) fn path(name: &str, value: &Bound<'_, PyAny>, n: usize) -> PyResult<Vec<Vec<f64>>> {
    let (got, values) = numbers(name, value)?;
    postures(&got, &values, n).ok_or_else(|| shape(name, &got, format!("({n},) or (N, {n})")))
}

fn postures(got: &[usize], values: &[f64], n: usize) -> Option<Vec<Vec<f64>>> {
    match got {
        [one] if *one == n => Some(vec![values.to_vec()]),
        [count, columns] if *columns == n && *count > 0 => Some(values.chunks(n).map(<[f64]>::to_vec).collect()),
        _ => None,
    }
}

/// Reads a target as a step does (a pose array has 0 0 0 1 as its last row), or postures. Three numbers are the posture
/// of an arm with three joints.
fn checked(value: &Bound<'_, PyAny>, n: usize, position_only: bool) -> PyResult<Checked> {
    let name = "path_or_pose";
    if let Some(pose) = pose_of_object(name, value)? {
        return Ok(Checked::Pose(pose));
    }
    let (got, values) = numbers(name, value)?;
    let last = [0.0, 0.0, 0.0, 1.0_f64];
    if got == [4, 4] && values[12..].iter().zip(last).all(|(a, b)| (a - b).abs() < 1e-12) {
        let row = |i: usize| [values[4 * i], values[4 * i + 1], values[4 * i + 2], values[4 * i + 3]];
        return CorePose::from_rows_of(name, &[row(0), row(1), row(2), row(3)]).or_raise().map(Checked::Pose);
    }
    if let (true, [3], [x, y, z]) = (position_only && n != 3, &got[..], &values[..]) {
        return Ok(Checked::Pose(CorePose { position: [*x, *y, *z], ..CorePose::IDENTITY }));
    }
    let position = if position_only && n != 3 { "(3,), " } else { "" };
    postures(&got, &values, n)
        .map(Checked::Path)
        .ok_or_else(|| shape(name, &got, format!("(4, 4), {position}({n},) or (N, {n})")))
}

/// Returns the default start of an IK search: the middle of the joint ranges.
fn middle(model: &CoreModel) -> Vec<f64> {
    let ranges = model.lower().iter().zip(model.upper());
    ranges.map(|(&low, &high)| if low.is_finite() && high.is_finite() { 0.5 * (low + high) } else { 0.0 }).collect()
}

/// Calls [`CoreController::check`] or [`CoreController::check_pose`], depending on the argument.
pub(crate) fn check_with(
    core: &CoreController,
    position_only: bool,
    path_or_pose: &Bound<'_, PyAny>,
    q0: Option<&Bound<'_, PyAny>>,
) -> PyResult<FeasibilityReport> {
    let n = core.model().n();
    match checked(path_or_pose, n, position_only)? {
        Checked::Path(path) => {
            path_or_pose.py().detach(|| analysis::check_path(core, &path)).or_raise().map(FeasibilityReport)
        }
        Checked::Pose(target) => {
            let start = match q0 {
                Some(q0) => joints("q0", q0, n)?[..n].to_vec(),
                None => middle(core.model()),
            };
            analysis::check_pose(core, &target, &start).or_raise().map(FeasibilityReport)
        }
    }
}

#[doc = stub!(check_path)]
#[pyfunction]
#[pyo3(signature = (model, settings, path_or_pose, *, servos = None, q0 = None))]
pub(crate) fn check_path(
    py: Python<'_>,
    #[pyo3(from_py_with = arguments::model)] model: Py<Model>,
    #[pyo3(from_py_with = arguments::settings)] settings: Py<Settings>,
    path_or_pose: &Bound<'_, PyAny>,
    #[pyo3(from_py_with = arguments::servos_or_none)] servos: Option<Py<Servos>>,
    q0: Option<&Bound<'_, PyAny>>,
) -> PyResult<FeasibilityReport> {
    Controller::new(py, model, Some(settings), servos)?.check(path_or_pose, q0)
}

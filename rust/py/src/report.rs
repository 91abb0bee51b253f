//! Python classes `PoseReport` with its `AxisReport`s, `FeasibilityReport` with its `Issue`s; function `check_path`.

use numpy::PyArray1;
use pliant_core::analysis;
use pliant_core::{
    Controller as CoreController, FeasibilityReport as CoreFeasibility, Issue as CoreIssue, Model as CoreModel,
    Pose as CorePose, PoseReport as CoreReport,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::arguments;
use crate::controller::Controller;
use crate::error::{OrRaise, shape};
use crate::model::Model;
use crate::ndarray::new_array;
use crate::read::compact::joints;
use crate::read::{numbers, pose_of_object};
use crate::servos::Servos;
use crate::settings::Settings;

/// Pair of values: for a push toward −, for a push toward +.
type Sides<T> = (T, T);

#[doc = stub!(JointStop)]
#[pyclass(module = "pliant.feasibility", frozen, get_all, eq)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct JointStop {
    #[doc = stub!(JointStop.joint)]
    joint: String,
    #[doc = stub!(JointStop.distance)]
    distance: f64,
    #[doc = stub!(JointStop.margin)]
    margin: f64,
    #[doc = stub!(JointStop.friction)]
    friction: f64,
}

#[doc = stub!(AxisReport)]
#[pyclass(module = "pliant.feasibility", frozen, get_all, eq)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct AxisReport {
    #[doc = stub!(AxisReport.name)]
    name: &'static str,
    #[doc = stub!(AxisReport.static_force)]
    static_force: Sides<f64>,
    #[doc = stub!(AxisReport.capacity)]
    capacity: Sides<f64>,
    #[doc = stub!(AxisReport.yields)]
    yields: Sides<bool>,
    #[doc = stub!(AxisReport.yield_force)]
    yield_force: Sides<(f64, f64)>,
    #[doc = stub!(AxisReport.thresholds)]
    thresholds: (f64, f64),
    #[doc = stub!(AxisReport.friction)]
    friction: f64,
    #[doc = stub!(AxisReport.friction_left)]
    friction_left: f64,
    #[doc = stub!(AxisReport.coupling)]
    coupling: Sides<f64>,
    #[doc = stub!(AxisReport.coupled_to)]
    coupled_to: Sides<Option<&'static str>>,
    #[doc = stub!(AxisReport.hold)]
    hold: f64,
    #[doc = stub!(AxisReport.default_hold)]
    default_hold: Option<f64>,
    #[doc = stub!(AxisReport.host_loss_force)]
    host_loss_force: Sides<f64>,
    #[doc = stub!(AxisReport.stop)]
    stop: Sides<Option<JointStop>>,
    #[doc = stub!(AxisReport.path_friction)]
    path_friction: Sides<f64>,
    #[doc = stub!(AxisReport.path_sigma)]
    path_sigma: Sides<f64>,
    #[doc = stub!(AxisReport.path_distance)]
    path_distance: Sides<f64>,
    #[doc = stub!(AxisReport.deviation_limit)]
    deviation_limit: Sides<f64>,
    #[doc = stub!(AxisReport.on_deviation_limit)]
    on_deviation_limit: String,
}

impl AxisReport {
    fn new(axis: &analysis::AxisReport, joints: &[String]) -> Self {
        let stop = axis.stop.map(|stop| {
            stop.map(|stop| JointStop {
                joint: joints[stop.joint].clone(),
                distance: stop.distance,
                margin: stop.margin,
                friction: stop.friction,
            })
        });
        Self {
            name: axis.name,
            static_force: axis.static_force.into(),
            capacity: axis.capacity.into(),
            yields: axis.yields.into(),
            yield_force: axis.yield_force.map(Into::into).into(),
            thresholds: axis.thresholds.into(),
            friction: axis.friction,
            friction_left: axis.friction_left,
            coupling: axis.coupling.into(),
            coupled_to: axis.coupled_to.into(),
            hold: axis.hold,
            default_hold: axis.default_hold,
            host_loss_force: axis.host_loss_force.into(),
            stop: stop.into(),
            path_friction: axis.path_friction.into(),
            path_sigma: axis.path_sigma.into(),
            path_distance: axis.path_distance.into(),
            deviation_limit: axis.deviation_limit.into(),
            on_deviation_limit: axis.on_deviation_limit.to_string(),
        }
    }
}

#[pymethods]
impl AxisReport {
    fn __repr__(&self) -> String {
        format!("<AxisReport: {}>", self.name)
    }
}

#[pymethods]
impl JointStop {
    fn __repr__(&self) -> String {
        format!("<JointStop: {} after {:.3}>", self.joint, self.distance)
    }
}

#[doc = stub!(PoseReport)]
#[pyclass(module = "pliant.feasibility", frozen, eq)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct PoseReport(pub(crate) CoreReport);

#[pymethods]
impl PoseReport {
    #[doc = stub!(PoseReport.axes)]
    #[getter]
    fn axes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let axes = PyDict::new(py);
        for axis in &self.0.axes {
            axes.set_item(axis.name, AxisReport::new(axis, &self.0.joints))?;
        }
        Ok(axes)
    }

    #[doc = stub!(PoseReport.joints)]
    #[getter]
    fn joints<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, &self.0.joints)
    }

    #[doc = stub!(PoseReport.q)]
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[self.0.q.len()], &self.0.q)
    }

    #[doc = stub!(PoseReport.torque_limit)]
    #[getter]
    fn torque_limit<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[self.0.torque_limit.len()], &self.0.torque_limit)
    }

    #[doc = stub!(PoseReport.gravity_margin)]
    #[getter]
    fn gravity_margin<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        pairs(py, &self.0.gravity_margin)
    }

    #[doc = stub!(PoseReport.sigma_min)]
    #[getter]
    fn sigma_min(&self) -> f64 {
        self.0.sigma_min
    }

    #[doc = stub!(PoseReport.condition)]
    #[getter]
    fn condition(&self) -> f64 {
        self.0.condition
    }

    #[doc = stub!(PoseReport.sigma_0)]
    #[getter]
    fn sigma_0(&self) -> f64 {
        self.0.sigma_0
    }

    #[doc = stub!(PoseReport.saturated)]
    #[getter]
    fn saturated<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        PyArray1::from_slice(py, &self.0.saturated)
    }

    #[doc = stub!(PoseReport.locked)]
    #[getter]
    fn locked<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        PyArray1::from_slice(py, &self.0.locked)
    }

    #[doc = stub!(PoseReport.max_host_loss_force)]
    #[getter]
    fn max_host_loss_force(&self) -> Option<f64> {
        self.0.max_host_loss_force
    }

    #[doc = stub!(PoseReport.gain_factor)]
    #[getter]
    fn gain_factor(&self) -> f64 {
        self.0.gain_factor
    }

    #[doc = stub!(PoseReport.damping_factor)]
    #[getter]
    fn damping_factor(&self) -> f64 {
        self.0.damping_factor
    }

    #[doc = stub!(PoseReport.summary)]
    fn summary(&self) -> Vec<String> {
        self.0.summary()
    }

    fn __str__(&self) -> String {
        self.0.to_string()
    }

    fn __repr__(&self) -> String {
        let axes: Vec<_> = self.0.axes.iter().map(|axis| axis.name).collect();
        format!("<PoseReport: axes {}; {} joints>", axes.join(" "), self.0.joints.len())
    }
}

fn pairs<'py>(py: Python<'py>, values: &[[f64; 2]]) -> Bound<'py, PyAny> {
    new_array(py, &[values.len(), 2], values.as_flattened())
}

#[doc = stub!(Issue)]
#[pyclass(module = "pliant.feasibility", frozen, eq)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Issue(CoreIssue);

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
pub(crate) struct FeasibilityReport(CoreFeasibility);

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

    #[doc = stub!(FeasibilityReport.issues)]
    #[getter]
    fn issues<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let found: PyResult<Vec<_>> = self.0.issues.iter().map(|issue| Bound::new(py, Issue(issue.clone()))).collect();
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

    #[doc = stub!(FeasibilityReport.path_sigma)]
    #[getter]
    fn path_sigma<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        pairs(py, &self.0.path_sigma)
    }

    fn __bool__(&self) -> bool {
        self.0.achievable
    }

    fn __str__(&self) -> String {
        self.0.to_string()
    }

    fn __repr__(&self) -> String {
        let verdict = if self.0.achievable { "achievable" } else { "not achievable" };
        format!("<FeasibilityReport: {verdict}, {} poses, {} issues>", self.0.poses, self.0.issues.len())
    }
}

/// Argument `path_or_pose` of a feasibility check.
enum Checked {
    Pose(CorePose),
    Path(Vec<Vec<f64>>),
}

/// Reads one posture (n,) or a path (N, n) [rad].
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

/// Reads the argument `path_or_pose`. An array (4, 4) is a pose (for an arm of four joints only if its last row is 0 0
/// 0 1). Three numbers are a position if the task has no rotations, unless the arm has three joints. Other arrays are
/// postures (n,) or (N, n).
fn checked(value: &Bound<'_, PyAny>, n: usize, position_only: bool) -> PyResult<Checked> {
    let name = "path_or_pose";
    if let Some(pose) = pose_of_object(name, value)? {
        return Ok(Checked::Pose(pose));
    }
    let (got, values) = numbers(name, value)?;
    let last = [0.0, 0.0, 0.0, 1.0_f64];
    if got == [4, 4] && (n != 4 || values[12..].iter().zip(last).all(|(a, b)| (a - b).abs() < 1e-12)) {
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

/// Returns the default start of a search for joint positions: the middle of each range, 0 for joints without limits.
fn middle(model: &CoreModel) -> Vec<f64> {
    let ranges = model.lower().iter().zip(model.upper());
    ranges.map(|(&low, &high)| if low.is_finite() && high.is_finite() { 0.5 * (low + high) } else { 0.0 }).collect()
}

/// Checks the settings along a path ([`analysis::check_path`]) or in a pose ([`analysis::check_pose`]). The search for
/// a pose starts at `q0`; `None`: at the middle of the joint ranges.
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

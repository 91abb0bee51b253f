//! Python class `Pose` and function `as_pose`.

use pliant_core::Pose as CorePose;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::error::OrRaise;
use crate::fields::text;
use crate::ndarray::new_array;
use crate::read::{array_into, vector3};

#[doc = stub!(Pose)]
#[pyclass(name = "Pose", module = "pliant", frozen, eq, from_py_object)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Pose(pub(crate) CorePose);

#[pymethods]
impl Pose {
    #[new]
    #[pyo3(signature = (matrix = None))]
    fn new(matrix: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        matrix.map_or(Ok(Self(CorePose::IDENTITY)), as_pose)
    }

    #[doc = stub!(Pose.from_matrix)]
    #[staticmethod]
    fn from_matrix(matrix: &Bound<'_, PyAny>) -> PyResult<Self> {
        as_pose(matrix)
    }

    #[doc = stub!(Pose.from_wxyz)]
    #[staticmethod]
    fn from_wxyz(position: &Bound<'_, PyAny>, quaternion: &Bound<'_, PyAny>) -> PyResult<Self> {
        let wxyz = quaternion_of(quaternion)?;
        CorePose::from_wxyz(vector3("position", position)?, wxyz).or_raise().map(Self)
    }

    #[doc = stub!(Pose.from_xyzw)]
    #[staticmethod]
    fn from_xyzw(position: &Bound<'_, PyAny>, quaternion: &Bound<'_, PyAny>) -> PyResult<Self> {
        let xyzw = quaternion_of(quaternion)?;
        CorePose::from_xyzw(vector3("position", position)?, xyzw).or_raise().map(Self)
    }

    #[doc = stub!(Pose.from_rotvec)]
    #[staticmethod]
    fn from_rotvec(position: &Bound<'_, PyAny>, rotvec: &Bound<'_, PyAny>) -> PyResult<Self> {
        CorePose::from_rotation_vector(vector3("position", position)?, vector3("rotvec", rotvec)?).or_raise().map(Self)
    }

    #[doc = stub!(Pose.from_rpy)]
    #[staticmethod]
    fn from_rpy(position: &Bound<'_, PyAny>, rpy: &Bound<'_, PyAny>) -> PyResult<Self> {
        CorePose::from_rpy(vector3("position", position)?, vector3("rpy", rpy)?).or_raise().map(Self)
    }

    #[doc = stub!(Pose.matrix)]
    #[getter]
    fn matrix<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        matrix(py, &self.0)
    }

    #[doc = stub!(Pose.position)]
    #[getter]
    fn position<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[3], &self.0.position)
    }

    #[doc = stub!(Pose.rotation)]
    #[getter]
    fn rotation<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[3, 3], self.0.rotation.as_flattened())
    }

    #[doc = stub!(Pose.wxyz)]
    #[getter]
    fn wxyz<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[4], &self.0.wxyz())
    }

    #[doc = stub!(Pose.xyzw)]
    #[getter]
    fn xyzw<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[4], &self.0.xyzw())
    }

    #[doc = stub!(Pose.rotvec)]
    #[getter]
    fn rotvec<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[3], &self.0.rotation_vector())
    }

    #[doc = stub!(Pose.inverse)]
    fn inverse(&self) -> Self {
        Self(self.0.inverse())
    }

    fn __matmul__(&self, other: &Self) -> Self {
        Self(self.0.compose(&other.0))
    }

    #[pyo3(signature = (dtype = None, copy = None))]
    fn __array__<'py>(
        &self,
        py: Python<'py>,
        dtype: Option<&Bound<'py, PyAny>>,
        copy: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        // The array is new in every case, so `copy` is ignored.
        let _ = copy;
        let array = matrix(py, &self.0);
        dtype.map_or(Ok(array.clone()), |dtype| array.call_method1("astype", (dtype,)))
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let rows = PyTuple::new(py, self.0.to_rows().map(|row| row.to_vec()))?;
        Ok(format!("Pose([{}])", rows.iter().map(|row| text(&row)).collect::<PyResult<Vec<_>>>()?.join(", ")))
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, [matrix(py, &self.0)])
    }
}

fn quaternion_of(value: &Bound<'_, PyAny>) -> PyResult<[f64; 4]> {
    let mut out = [0.0; 4];
    array_into("quaternion", value, &[4], &mut out)?;
    Ok(out)
}

/// Returns the homogeneous matrix of a pose as a new array (4, 4).
pub(crate) fn matrix<'py>(py: Python<'py>, pose: &CorePose) -> Bound<'py, PyAny> {
    new_array(py, &[4, 4], pose.to_rows().as_flattened())
}

#[doc = stub!(as_pose)]
#[pyfunction]
#[pyo3(signature = (pose, /))]
pub(crate) fn as_pose(pose: &Bound<'_, PyAny>) -> PyResult<Pose> {
    let pose = crate::read::pose("pose", pose, true)?;
    pose.validate().or_raise()?;
    Ok(Pose(pose))
}

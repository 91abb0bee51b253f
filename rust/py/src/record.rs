//! The intermediates of the last step as attributes.

/// Makes a read-only attribute of each field of the core's record, and adds the methods in `methods`.
///
/// `axes`: one number per task axis; `joints`: one per joint; `flags`: one truth value per joint.
macro_rules! readings {
    (
        $class:ident {
            axes: $($axis:ident),*;
            joints: $($joint:ident),*;
            numbers: $($number:ident),*;
            flags: $($flag:ident),*;
            matrices: $($matrix:ident),*;
        }
        methods { $($methods:tt)* }
    ) => {
        #[pymethods]
        impl $class {
            $(#[getter]
            fn $axis<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
                $crate::convert::new_array(py, &[self.core.task_len()], &self.core.record().$axis)
            })*

            $(#[getter]
            fn $joint<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
                $crate::convert::new_array(py, &[self.n], &self.core.record().$joint)
            })*

            $(#[getter]
            fn $number(&self) -> f64 {
                self.core.record().$number
            })*

            $(#[getter]
            fn $flag<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
                numpy::PyArray1::from_slice(py, &self.core.record().$flag[..self.n]).into_any()
            })*

            $(#[getter]
            fn $matrix<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
                $crate::functions::table(py, &self.core.$matrix())
            })*

            $($methods)*
        }
    };
}

pub(crate) use readings;

//! Control steps of many arms: `Controller.step_batch` and the Python class `BatchState`.

use pliant_core::{
    BatchCommand, BatchInput, BatchState as CoreState, Controller as CoreController, MAX_AXES, OnInvalid,
    Pose as CorePose, Targets,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::batch::{Rows, rows_of, target};
use crate::command::Command;
use crate::error::{OrRaise, shape, wrong_type};
use crate::in_use::{exclusive, shared};
use crate::kinds::Kind;
use crate::ndarray::{Lent, lend, new_array, rows};
use crate::read::compact::pose;
use crate::read::numbers;
use crate::words::{Word, Words};

impl Words for OnInvalid {
    const WORDS: &'static [(&'static str, Self)] = &[("raise", Self::Error), ("nan", Self::Nan)];
}

#[doc = stub!(BatchState)]
#[pyclass(module = "pliant.types")]
#[derive(Debug)]
pub(crate) struct BatchState(CoreState);

impl BatchState {
    /// Reads the argument `state`; another type raises a `TypeError`.
    pub(crate) fn from_argument<'a, 'py>(state: &'a Bound<'py, PyAny>) -> PyResult<&'a Bound<'py, Self>> {
        state.cast().map_err(|_| wrong_type("state", "a BatchState, as batch_state(N) makes one", state))
    }

    /// Creates the state of `count` arms before their first step, each with `n` joints.
    pub(crate) fn of(n: usize, count: usize) -> PyResult<Self> {
        CoreState::new(n, count).or_raise().map(Self)
    }
}

#[pymethods]
impl BatchState {
    #[new]
    fn new(n: &Bound<'_, PyAny>, numbers: &Bound<'_, PyAny>) -> PyResult<Self> {
        let n = crate::read::count("n", n)?;
        CoreState::from_vec(n, crate::read::numbers("numbers", numbers)?.1).or_raise().map(Self)
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> (usize, Bound<'py, PyAny>) {
        let numbers = self.0.as_slice();
        (self.0.n(), new_array(py, &[numbers.len()], numbers))
    }

    #[doc = stub!(BatchState.n)]
    #[getter]
    fn n(&self) -> usize {
        self.0.n()
    }

    fn __len__(&self) -> usize {
        self.0.len()
    }

    #[doc = stub!(BatchState.reset)]
    #[pyo3(signature = (indices = None, Q = None))]
    #[expect(non_snake_case, reason = "`Q` holds many `q`, as documented")]
    fn reset(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        indices: Option<&Bound<'_, PyAny>>,
        Q: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let (count, n) = {
            let state = shared(slf)?;
            (state.0.len(), state.0.n())
        };
        let indices = picked(py, count, indices)?;
        let Some(given) = Q else {
            let mut state = exclusive(slf)?;
            return indices.into_iter().try_for_each(|index| state.0.reset(index, None)).or_raise();
        };
        let (got, values) = numbers("Q", given)?;
        let one = got == [n];
        if !one && got != [indices.len(), n] {
            return Err(shape("Q", &got, format!("({}, {n}), or ({n},) for all", indices.len())));
        }
        // Check all rows first, so that no arm changes if one row is invalid.
        let mut tried = CoreState::new(n, 1).or_raise()?;
        values.chunks_exact(n).try_for_each(|q| tried.reset(0, Some(q))).or_raise()?;
        let mut state = exclusive(slf)?;
        for (i, index) in indices.into_iter().enumerate() {
            let from = if one { 0 } else { i * n };
            state.0.reset(index, Some(&values[from..from + n])).or_raise()?;
        }
        Ok(())
    }

    fn __repr__(&self) -> String {
        format!("<BatchState of {} arms of {} joints>", self.0.len(), self.0.n())
    }
}

/// Returns the arms that a NumPy index selects from `count` arms: a number, numbers, a slice or a mask; all arms for
/// `None`.
fn picked(py: Python<'_>, count: usize, indices: Option<&Bound<'_, PyAny>>) -> PyResult<Vec<usize>> {
    let Some(indices) = indices else { return Ok((0..count).collect()) };
    let numpy = py.import("numpy")?;
    // An empty list would become an array of floats, which is not a valid index.
    let empty = indices.len().is_ok_and(|length| length == 0);
    if empty {
        return Ok(Vec::new());
    }
    let index = if indices.is_instance_of::<pyo3::types::PySlice>() {
        indices.clone()
    } else {
        numpy.call_method1("asarray", (indices,))?
    };
    let options = PyDict::new(py);
    options.set_item("ndmin", 1)?;
    let found = numpy.call_method1("arange", (count,))?.get_item(index)?;
    numpy.call_method("array", (found,), Some(&options))?.call_method0("tolist")?.extract()
}

/// Arguments of one call of `step_batch`, besides `Q` and `state`.
pub(crate) struct BatchCall<'a, 'py> {
    pub(crate) targets: &'a Bound<'py, PyAny>,
    /// True for a task without rotations: targets may be positions (3,).
    pub(crate) position_only: bool,
    pub(crate) dt: Option<f64>,
    pub(crate) dq: Option<&'a Bound<'py, PyAny>>,
    pub(crate) caps: Option<&'a Bound<'py, PyAny>>,
    pub(crate) adaptation: Option<&'a Bound<'py, PyAny>>,
    pub(crate) invalid: Option<&'a Bound<'py, PyAny>>,
    pub(crate) out: Option<&'a Bound<'py, PyAny>>,
}

/// Targets of a batch: one pose for all arms, or a pose or position per arm.
enum Wanted<'a, 'py> {
    One(CorePose),
    Poses(Rows<'a, 'py>),
    Positions(Rows<'a, 'py>),
}

impl<'py> BatchCall<'_, 'py> {
    /// Steps all arms without the interpreter lock, and returns their command.
    pub(crate) fn run(
        &self,
        py: Python<'_>,
        core: &CoreController,
        q: &Bound<'_, PyAny>,
        state: Option<&Bound<'_, BatchState>>,
    ) -> PyResult<Py<Command>> {
        let n = core.model().n();
        let own = self.out.map(arrays_of).transpose()?;
        let outs: Vec<&Bound<'_, PyAny>> = own.iter().flatten().collect();
        let part = [n];
        let q = Rows::read("Q", q, &part, &outs)?;
        let count = q.count;
        let wanted = self.wanted(count, &outs)?;
        let dq = optional_rows("dq", self.dq, count, &part, &outs)?;
        let caps = optional_rows("caps", self.caps, count, &[MAX_AXES], &outs)?;
        let adaptation = optional_rows("adaptation", self.adaptation, count, &[MAX_AXES], &outs)?;
        let invalid = self.invalid.map_or(Ok(OnInvalid::Error), |word| Word::<OnInvalid>::read("invalid", word))?;
        let mut arrays = Vec::with_capacity(3);
        for i in 0..3 {
            let own = own.as_ref().map(|own| &own[i]);
            arrays.push(target(py, &format!("out[{i}]"), own, count, &[n])?);
        }
        let (one, targets, are_positions) = match &wanted {
            Wanted::One(pose) => (Some(pose), Lent::Numbers(&[]), false),
            Wanted::Poses(rows) => (None, rows.lent(), false),
            Wanted::Positions(rows) => (None, rows.lent(), true),
        };
        let given = [&dq, &caps, &adaptation].map(Option::is_some);
        let [dq, caps, adaptation] =
            [&dq, &caps, &adaptation].map(|rows| rows.as_ref().map_or(Lent::Numbers(&[]), Rows::lent));
        let dt = self.dt;
        let mut state = state.map(exclusive).transpose()?;
        let state = state.as_deref_mut().map(|state| &mut state.0);
        let (names, shape) = (["out[0]", "out[1]", "out[2]"], [count, n]);
        let outs = [0, 1, 2].map(|i| (names[i], &arrays[i], &shape[..]));
        let inputs = [q.lent(), targets, dq, caps, adaptation];
        lend(py, &inputs, outs, |[q, targets, dq, caps, adaptation], [goal, torque_limit, velocity]| {
            let targets = match one {
                Some(pose) => Targets::One(pose),
                None if are_positions => Targets::Positions(targets),
                None => Targets::Poses(targets),
            };
            let [dq, caps, adaptation] =
                [(given[0], dq), (given[1], caps), (given[2], adaptation)].map(|(given, rows)| given.then_some(rows));
            let input = BatchInput { q, targets, dt, dq, caps, adaptation, invalid };
            core.step_batch(&input, state, BatchCommand { goal, torque_limit, velocity })
        })?
        .or_raise()?;
        match self.out.and_then(|out| out.cast::<Command>().ok()) {
            Some(command) => Ok(command.clone().unbind()),
            None => Py::new(py, Command::of([0, 1, 2].map(|i| arrays[i].clone().unbind()))),
        }
    }

    /// Reads `targets`: an array with a pose (or position) for each of `count` arms, or else one pose for all.
    fn wanted(&self, count: usize, outs: &[&Bound<'_, PyAny>]) -> PyResult<Wanted<'_, 'py>> {
        let (name, targets) = ("targets", self.targets);
        let parts: &'static [&'static [usize]] = if self.position_only { &[&[4, 4], &[3]] } else { &[&[4, 4]] };
        let fits = |got: &[usize]| parts.iter().find(|part| got.split_first().is_some_and(|(_, rest)| rest == **part));
        let plain = parts.iter().find_map(|part| rows(targets, part).map(|count| (count, *part)));
        let (got, part) = match plain {
            Some(found) => found,
            // Not a C-ordered float64 array (N, ...): a single pose, or an object that NumPy converts.
            None => match numbers(name, targets) {
                Ok((got, _)) if fits(&got).is_some() => (got[0], *fits(&got).unwrap_or(&parts[0])),
                Ok((got, _)) if !matches!(got[..], [4, 4] | [3 | 7]) => {
                    let many: Vec<String> = parts.iter().map(|part| rows_of(part)).collect();
                    let one = if self.position_only { "(4, 4), (3,)" } else { "(4, 4)" };
                    return Err(shape(name, &got, format!("{one}, {}", many.join(" or "))));
                }
                _ => return pose(name, targets, self.position_only).map(Wanted::One),
            },
        };
        if got != count {
            let expected = format!("{} with N = {count} as Q has, or one pose for all", rows_of(part));
            return Err(shape(name, &[&[got], part].concat(), expected));
        }
        let rows = Rows::read(name, targets, part, outs)?;
        Ok(if part.len() == 2 { Wanted::Poses(rows) } else { Wanted::Positions(rows) })
    }
}

/// Reads an optional array with `part` numbers for each of `count` arms.
fn optional_rows<'a, 'py>(
    name: &'a str,
    array: Option<&'a Bound<'py, PyAny>>,
    count: usize,
    part: &'a [usize; 1],
    outs: &[&Bound<'_, PyAny>],
) -> PyResult<Option<Rows<'a, 'py>>> {
    let Some(array) = array else { return Ok(None) };
    let rows = Rows::read(name, array, part, outs)?;
    if rows.count == count {
        Ok(Some(rows))
    } else {
        Err(shape(name, &[rows.count, part[0]], format!("({count}, {})", part[0])))
    }
}

/// Reads the argument `out`: the arrays of a command, or a tuple of three arrays.
fn arrays_of<'py>(out: &Bound<'py, PyAny>) -> PyResult<[Bound<'py, PyAny>; 3]> {
    if let Ok(command) = out.cast::<Command>() {
        return Ok(command.get().arrays().map(|array| array.bind(out.py()).clone()));
    }
    match out.cast::<PyTuple>() {
        Ok(three) if three.len() == 3 => Ok([three.get_item(0)?, three.get_item(1)?, three.get_item(2)?]),
        _ => Err(wrong_type("out", "a command of a batch, or arrays (goal, torque_limit, velocity)", out)),
    }
}

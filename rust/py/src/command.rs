//! Python class `Command`, and the pool from which control steps take their commands.

use pliant_core::Command as CoreCommand;
use pyo3::prelude::*;

use crate::error::wrong_type;
use crate::ndarray::{new_array, only_reference, overwrite, writable, write};
use crate::read::compact::array_into;
use crate::read::vector;

#[doc = stub!(Command)]
#[pyclass(module = "pliant", frozen, get_all)]
#[derive(Debug)]
pub(crate) struct Command {
    #[doc = stub!(Command.goal)]
    goal: Py<PyAny>,
    #[doc = stub!(Command.torque_limit)]
    torque_limit: Py<PyAny>,
    #[doc = stub!(Command.speed_limit)]
    speed_limit: Py<PyAny>,
}

#[pymethods]
impl Command {
    #[new]
    #[pyo3(signature = (goal, torque_limit, speed_limit=None))]
    fn from_arrays(
        goal: &Bound<'_, PyAny>,
        torque_limit: &Bound<'_, PyAny>,
        speed_limit: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let py = goal.py();
        let goal = vector("goal", goal)?;
        let mut limit = vec![0.0; goal.len()];
        array_into("torque_limit", torque_limit, &[goal.len()], &mut limit)?;
        let mut speed = vec![f64::INFINITY; goal.len()];
        if let Some(speed_limit) = speed_limit {
            array_into("speed_limit", speed_limit, &[goal.len()], &mut speed)?;
        }
        Ok(Self::of([goal, limit, speed].map(|values| new_array(py, &[values.len()], &values).unbind())))
    }

    fn __getnewargs__(&self, py: Python<'_>) -> (Py<PyAny>, Py<PyAny>, Py<PyAny>) {
        (self.goal.clone_ref(py), self.torque_limit.clone_ref(py), self.speed_limit.clone_ref(py))
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let text = |array: &Py<PyAny>| array.bind(py).repr().map(|repr| repr.to_string());
        let (goal, limit, speed_limit) = (text(&self.goal)?, text(&self.torque_limit)?, text(&self.speed_limit)?);
        Ok(format!("Command(goal={goal}, torque_limit={limit}, speed_limit={speed_limit})"))
    }
}

impl Command {
    fn new(py: Python<'_>, core: &CoreCommand) -> Self {
        let array = |values: &[f64]| new_array(py, &[values.len()], values).unbind();
        Self {
            goal: array(core.goal()),
            torque_limit: array(core.torque_limit()),
            speed_limit: array(core.speed_limit()),
        }
    }

    /// Creates a command from its arrays.
    pub(crate) fn of([goal, torque_limit, speed_limit]: [Py<PyAny>; 3]) -> Self {
        Self { goal, torque_limit, speed_limit }
    }

    /// Returns the arrays: goal, torque limit, speed limit.
    pub(crate) fn arrays(&self) -> [&Py<PyAny>; 3] {
        [&self.goal, &self.torque_limit, &self.speed_limit]
    }

    fn parts<'a>(&'a self, core: &'a CoreCommand) -> [(&'a Py<PyAny>, &'a [f64]); 3] {
        [(&self.goal, core.goal()), (&self.torque_limit, core.torque_limit()), (&self.speed_limit, core.speed_limit())]
    }

    /// Overwrites the arrays; returns `false` at the first array that Python code refers to or that is not writable.
    #[inline]
    fn refill(&self, py: Python<'_>, core: &CoreCommand) -> bool {
        self.parts(core).into_iter().all(|(array, values)| overwrite(array.bind(py), values))
    }

    /// Returns `out` as a command; an error if it is not a command, or if its arrays are not writable float64 arrays of
    /// `n` numbers.
    #[inline]
    pub(crate) fn writable<'a, 'py>(out: &'a Bound<'py, PyAny>, n: usize) -> PyResult<&'a Bound<'py, Self>> {
        let out = out.cast::<Self>().map_err(|_| wrong_type("out", "a Command, as a step returns it", out))?;
        let command = out.get();
        for array in [&command.goal, &command.torque_limit, &command.speed_limit] {
            let array = array.bind(out.py());
            if !writable(array, &[n]) {
                return Err(unwritable(array, n));
            }
        }
        Ok(out)
    }

    /// Overwrites the arrays, even if Python code refers to them; an error if one is no longer writable.
    pub(crate) fn fill(&self, py: Python<'_>, core: &CoreCommand) -> PyResult<()> {
        for (array, values) in self.parts(core) {
            if !write(array.bind(py), &[values.len()], values) {
                return Err(unwritable(array.bind(py), values.len()));
            }
        }
        Ok(())
    }
}

#[cold]
fn unwritable(array: &Bound<'_, PyAny>, n: usize) -> PyErr {
    wrong_type("out", &format!("a command whose arrays are writable float64 of {n} in C order"), array)
}

/// Three commands in rotation. A command is reused only if neither it nor one of its arrays has another reference.
///
/// So a loop that keeps no command allocates nothing, and a command that the caller keeps never changes. Reference
/// counts are reliable only under the interpreter lock, which the module requires; a free-threaded Python gets a new
/// command from every step.
#[derive(Debug, Default)]
pub(crate) struct Pool {
    slots: [Option<Py<Command>>; 3],
    next: usize,
    /// Number of commands created so far.
    pub(crate) created: u64,
}

impl Pool {
    /// Returns a command with the numbers of `core`: a reused one if possible, else a new one.
    #[inline]
    pub(crate) fn take(&mut self, py: Python<'_>, core: &CoreCommand) -> PyResult<Py<Command>> {
        let slot = &mut self.slots[self.next];
        self.next = (self.next + 1) % 3;
        if let Some(command) = slot
            && only_reference(command.bind(py).as_any())
            && command.get().refill(py, core)
        {
            return Ok(command.clone_ref(py));
        }
        let made = Py::new(py, Command::new(py, core))?;
        self.created += 1;
        *slot = Some(made.clone_ref(py));
        Ok(made)
    }
}

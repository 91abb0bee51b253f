//! State of many arms between batch steps: one row of numbers for each arm.

use crate::error::{Error, Result};
use crate::params::Settings;
use crate::pose::COORDINATE_BOUND;
use crate::{MAX_AXES, MAX_JOINTS};

/// Returns the number of values in the row of an arm of `n` joints.
pub(crate) const fn row_len(n: usize) -> usize {
    2 + 7 * n + 3 * MAX_AXES + 2 * POSE + MAX_AXES + 2
}

/// Number of values of a pose: rotation matrix and position.
const POSE: usize = 12;

/// Status flags of an arm; their sum is element 0 of its row. With the sum 0, no step has run: the next step resets the
/// arm to its measured positions.
#[derive(Clone, Copy)]
pub(crate) enum Flag {
    /// At least one reset or step has run.
    Started = 1,
    /// The singular vectors must be computed without those of a previous step.
    Cold = 2,
    /// The row contains torque limits, from which the next limits may rise only at a bounded rate.
    Limited = 4,
    /// The row contains only joint positions, to which the next step resets the arm.
    Reset = 8,
}

/// Status of one arm, read from its row.
#[derive(Debug, Clone, Copy)]
pub(crate) enum RowStatus<'a> {
    /// No step has run: the next step resets the arm to its measured positions.
    New,
    /// The next step resets the arm to these joint positions [rad].
    Reset(&'a [f64]),
    /// The row contains the state after the last step.
    Running,
}

/// State of many arms for [`Controller::step_batch`](crate::Controller::step_batch): `8 (52 + 7 n)` bytes per arm.
///
/// Any controller of an arm with the same number of joints can continue from it. The first step of an arm resets it to
/// its measured positions, or to the positions given to [`BatchState::reset`].
#[derive(Debug, Clone, PartialEq)]
pub struct BatchState {
    n: usize,
    rows: Vec<f64>,
    /// Settings of the last step. A step with different settings resets the parts of the state that depend on them.
    pub(crate) settings: Option<Box<Settings>>,
}

impl BatchState {
    /// Creates the state of `count` arms of `n` joints before their first step.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for an invalid number of joints, or for more arms than memory can hold.
    pub fn new(n: usize, count: usize) -> Result<Self> {
        if n == 0 || n > MAX_JOINTS {
            return Err(Error::out_of_range("joints", n as f64, format!("1 to {MAX_JOINTS}")));
        }
        let mut rows = Vec::new();
        let room = count.checked_mul(row_len(n)).filter(|&size| rows.try_reserve_exact(size).is_ok());
        let size = room.ok_or_else(|| {
            Error::out_of_range("arms", count as f64, format!("the free memory at {} bytes an arm", 8 * row_len(n)))
        })?;
        rows.resize(size, 0.0);
        Ok(Self { n, rows, settings: None })
    }

    /// Creates the state from the result of [`BatchState::as_slice`].
    ///
    /// # Errors
    /// As [`BatchState::new`]; [`Error::Shape`] if the length is not a multiple of one arm's length.
    pub fn from_vec(n: usize, numbers: Vec<f64>) -> Result<Self> {
        let empty = Self::new(n, 0)?;
        if !numbers.len().is_multiple_of(row_len(n)) {
            return Err(Error::rows("state", numbers.len(), row_len(n)));
        }
        Ok(Self { rows: numbers, ..empty })
    }

    /// Returns the numbers of all rows. Only the same version of this crate can interpret them.
    pub fn as_slice(&self) -> &[f64] {
        &self.rows
    }

    /// Returns the number of joints of an arm.
    pub fn n(&self) -> usize {
        self.n
    }

    /// Returns the number of arms.
    pub fn len(&self) -> usize {
        self.rows.len() / row_len(self.n)
    }

    /// Returns true if there are no arms.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Resets arm `index`: its next step starts from `q` [rad]; `None`: from its measured positions.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if `index` is too large or `q` is not finite, [`Error::Shape`] for a wrong length of `q`.
    pub fn reset(&mut self, index: usize, q: Option<&[f64]>) -> Result<()> {
        if let Some(q) = q {
            if q.len() != self.n {
                return Err(Error::length("Q", q.len(), self.n));
            }
            if let Some(&value) = q.iter().find(|value| !(value.abs() <= COORDINATE_BOUND)) {
                return Err(Error::out_of_range("q", value, format!("±{COORDINATE_BOUND:e}")).in_row("Q", index));
            }
        }
        let (row_len, count) = (row_len(self.n), self.len());
        let missing = || Error::out_of_range("arm", index as f64, format!("a state of {count} arms"));
        RowStatus::reset_row(self.rows.chunks_exact_mut(row_len).nth(index).ok_or_else(missing)?, q);
        Ok(())
    }

    /// Returns the rows of all arms; an error if the state is not that of `count` arms of `n` joints.
    pub(crate) fn rows_of(&mut self, n: usize, count: usize) -> Result<&mut [f64]> {
        let got = self.len();
        if self.n != n || got != count {
            return Err(Error::Shape {
                what: "state".into(),
                got: format!("({got} arms of {} joints)", self.n),
                expected: format!("({count} arms of {n} joints)"),
            });
        }
        Ok(&mut self.rows)
    }
}

impl Flag {
    /// Returns true if the sum of flags contains this flag.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a sum of flags")]
    pub(crate) fn is_in(self, flags: f64) -> bool {
        (flags as u32) & self as u32 != 0
    }
}

impl<'a> RowStatus<'a> {
    /// Returns the status of an arm of `n` joints from its row.
    pub(crate) fn of(row: &'a [f64], n: usize) -> Self {
        match row.split_first() {
            Some((&flags, rest)) if Flag::Reset.is_in(flags) => Self::Reset(&rest[..n.min(rest.len())]),
            Some((&flags, _)) if Flag::Started.is_in(flags) => Self::Running,
            _ => Self::New,
        }
    }

    /// Marks the arm of `row` for a reset to `q` [rad]; `None`: to the measured positions of its next step.
    pub(crate) fn reset_row(row: &mut [f64], q: Option<&[f64]>) {
        row.fill(0.0);
        if let (Some(q), Some((first, rest))) = (q, row.split_first_mut()) {
            *first = f64::from(Flag::Reset as u32);
            rest.iter_mut().zip(q).for_each(|(slot, value)| *slot = *value);
        }
    }
}

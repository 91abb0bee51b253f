//! Python class `ServoCodec`: registers of the servos on a bus as joint values, and commands as registers.

use pliant_core::arm::{Decoded, MAX_PACKET, Register, ServoCodec as CoreCodec, ServoUnits};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyList, PyTuple};

use crate::error::{OrRaise, shape, tuple};
use crate::joint_readings::JointReadings;
use crate::ndarray::new_array;
use crate::read::compact::array_into;
use crate::read::vector;

/// Length of the list of numbers that describes registers, packets and units of a servo.
const NUMBERS: usize = 10 * 3 + 2 * 2 + 20;

#[doc = stub!(ServoCodec)]
#[pyclass(module = "pliant._core")]
#[derive(Debug)]
pub(crate) struct ServoCodec {
    pub(crate) core: CoreCodec,
    pub(crate) packets: [[u8; MAX_PACKET]; 2],
    command: [Vec<f64>; 3],
}

impl ServoCodec {
    /// Returns the readings of all joints; marks a joint as new if all its servos are in `read`.
    pub(crate) fn joints(&mut self, read: &[usize]) -> JointReadings {
        let (joints, ok) = self.core.joints(read);
        JointReadings::of_servos(joints, ok)
    }

    /// Stores a reading of a servo that was requested at `time`. A reading that comes more than `longest` [s] after the
    /// one before is not stored, because the servo may have restarted meanwhile. Returns the value that
    /// [`Self::decode`] reports for the servo; the outer `None`: it reports nothing.
    #[expect(clippy::option_option, reason = "a report, of which `None` is one of three values in Python")]
    pub(crate) fn store(
        &mut self,
        servo: usize,
        data: &[u8],
        status: u8,
        address: usize,
        [time, longest]: [f64; 2],
    ) -> PyResult<Option<Option<bool>>> {
        if time - self.core.reading(servo).or_raise()?.0.time > longest {
            return Ok(Some(None));
        }
        Ok(match self.core.decode(servo, data, address, status != 0, time).or_raise()? {
            Decoded::Usual => None,
            decoded => Some(Some(decoded == Decoded::Notable)),
        })
    }

    /// Reads and checks goals, torque limits and largest speeds (n,) of all joints.
    pub(crate) fn set_command(
        &mut self,
        goal: &Bound<'_, PyAny>,
        limit: &Bound<'_, PyAny>,
        velocity: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        let given = [("goal", Some(goal)), ("limit", Some(limit)), ("velocity", velocity)];
        for ((name, value), row) in given.into_iter().zip(&mut self.command) {
            match value {
                Some(value) => array_into(name, value, &[row.len()], row)?,
                None => row.fill(f64::INFINITY),
            }
        }
        self.core.check_command(self.command.each_ref().map(|row| &row[..])).or_raise()
    }

    /// Returns goal, limit and speed cap registers of a servo for the command of `set_command`, and the sizes of its
    /// packets in `packets`.
    pub(crate) fn encode_command(&mut self, servo: usize, max_speed: f64) -> PyResult<([i64; 3], [usize; 2])> {
        let joint = self.core.joint(servo).or_raise()?;
        let command = [0, 1, 2].map(|i: usize| self.command[i][joint]);
        self.core.encode(servo, command, max_speed, &mut self.packets).or_raise()
    }
}

#[pymethods]
impl ServoCodec {
    #[new]
    fn new(servos: usize, joints: usize) -> Self {
        Self {
            core: CoreCodec::new(servos, joints),
            packets: [[0; MAX_PACKET]; 2],
            command: [(); 3].map(|()| vec![0.0; joints]),
        }
    }

    #[doc = stub!(ServoCodec.configure)]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "addresses, sizes and bits")]
    fn configure(&mut self, servo: usize, joint: usize, numbers: &Bound<'_, PyAny>) -> PyResult<()> {
        let numbers = vector("numbers", numbers)?;
        let Ok(numbers): Result<&[f64; NUMBERS], _> = numbers.as_slice().try_into() else {
            return Err(shape("numbers", &[numbers.len()], tuple(&[NUMBERS])));
        };
        // Addresses, sizes and signs; other numbers are truncated to integers.
        let whole = |i: usize| numbers[i] as i64;
        let mut registers = [Register::default(); 10];
        for (i, place) in registers.iter_mut().enumerate() {
            *place =
                Register { address: whole(3 * i) as usize, size: whole(3 * i + 1) as usize, sign: whole(3 * i + 2) };
        }
        let packet = |i: usize| [whole(30 + 2 * i) as usize, whole(31 + 2 * i) as usize];
        let &[
            ..,
            zero,
            sign,
            count,
            velocity,
            measured,
            lost,
            uses_current,
            current,
            limit,
            limit_lost,
            ceiling,
            usable,
            max_speed,
            no_load_speed,
            low,
            high,
            max_position,
            turn,
            multi_turn,
            min_voltage,
        ] = numbers;
        let units = ServoUnits {
            registers,
            packets: [packet(0), packet(1)],
            zero,
            sign,
            count,
            velocity,
            measured: [measured, lost],
            uses_current,
            current,
            limit: [limit, limit_lost],
            ceiling: [ceiling, usable],
            max_speed,
            no_load_speed,
            range: [low, high],
            max_position,
            turn,
            multi_turn,
            min_voltage,
        };
        self.core.configure(servo, joint, &units).or_raise()
    }

    #[doc = stub!(ServoCodec.decode)]
    fn decode<'py>(
        &mut self,
        py: Python<'py>,
        servos: Vec<usize>,
        answers: &Bound<'py, PyList>,
        address: usize,
        time: f64,
        longest: f64,
    ) -> PyResult<Bound<'py, PyList>> {
        let notable = PyList::empty(py);
        for (i, (servo, answer)) in servos.into_iter().zip(answers).enumerate() {
            let (data, status) = answer.extract::<(Bound<'py, PyBytes>, u8)>()?;
            if let Some(found) = self.store(servo, data.as_bytes(), status, address, [time, longest])? {
                notable.append((i, found))?;
            }
        }
        Ok(notable)
    }

    #[doc = stub!(ServoCodec.joints)]
    #[pyo3(name = "joints")]
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 passes extracted arguments by value")]
    fn joints_of(&mut self, read: Vec<usize>) -> JointReadings {
        self.joints(&read)
    }

    #[doc = stub!(ServoCodec.encode)]
    fn encode<'py>(
        &mut self,
        py: Python<'py>,
        servos: Vec<usize>,
        goal: &Bound<'py, PyAny>,
        limit: &Bound<'py, PyAny>,
        velocity: Option<&Bound<'py, PyAny>>,
        max_speed: f64,
    ) -> PyResult<Bound<'py, PyTuple>> {
        self.set_command(goal, limit, velocity)?;
        let registers = [(); 3].map(|()| PyList::empty(py));
        let packets = [(); 2].map(|()| PyList::empty(py));
        for servo in servos {
            let (values, sizes) = self.encode_command(servo, max_speed)?;
            for (list, value) in registers.iter().zip(values) {
                list.append(value)?;
            }
            for ((list, packet), size) in packets.iter().zip(&self.packets).zip(sizes) {
                list.append(PyBytes::new(py, packet.get(..size).unwrap_or_default()))?;
            }
        }
        let [goals, limits, speeds] = registers;
        let [first, second] = packets;
        PyTuple::new(py, [goals, limits, speeds, first, second])
    }

    #[doc = stub!(ServoCodec.has_command)]
    fn has_command(&self, servo: usize, data: &[u8], address: usize) -> PyResult<bool> {
        self.core.has_command(servo, data, address).or_raise()
    }

    #[doc = stub!(ServoCodec.record_sent)]
    #[pyo3(signature = (servo, goal, limit, packet))]
    fn record_sent(&mut self, servo: usize, goal: Option<i64>, limit: i64, packet: &[u8]) -> PyResult<()> {
        self.core.record_sent(servo, goal, limit, packet).or_raise()
    }

    #[doc = stub!(ServoCodec.sent)]
    fn sent<'py>(&self, py: Python<'py>, servo: usize) -> PyResult<(Option<i64>, i64, u32, Bound<'py, PyBytes>)> {
        let sent = self.core.sent(servo).or_raise()?;
        Ok((sent.goal, sent.limit, sent.count, PyBytes::new(py, sent.packet())))
    }

    #[doc = stub!(ServoCodec.reading)]
    fn reading<'py>(&self, py: Python<'py>, servo: usize) -> PyResult<Bound<'py, PyAny>> {
        let (reading, rejected, jump) = self.core.reading(servo).or_raise()?;
        let [voltage, temperature] = reading.supply.map(|value| value.map_or(f64::NAN, |value| value as f64));
        let position = reading.position.unwrap_or(f64::NAN);
        let rejected = f64::from(rejected);
        let numbers = [position, reading.turns, reading.time, voltage, temperature, reading.supplied, rejected, jump];
        Ok(new_array(py, &[numbers.len()], &numbers))
    }

    #[doc = stub!(ServoCodec.accept_any)]
    fn accept_any(&mut self, servo: usize, position: f64, turns: f64, time: f64) -> PyResult<()> {
        self.core.accept_any(servo, [position, turns, time]).or_raise()
    }
}

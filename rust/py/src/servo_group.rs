//! Python class `ServoGroup`: requests to several servos on a serial port, with conversion between registers and joints.

use pliant_core::arm::MAX_PACKET;
use pyo3::prelude::*;
use pyo3::types::PyList;

use crate::error::OrRaise;
use crate::serial::{self, SerialPort};
use crate::servo_codec::ServoCodec;

#[doc = stub!(ServoGroup)]
#[pyclass(module = "pliant._core", frozen)]
#[derive(Debug)]
pub(crate) struct ServoGroup {
    port: Py<SerialPort>,
    codec: Py<ServoCodec>,
    servos: Vec<usize>,
    ids: Vec<u8>,
    /// True if the codec has no other servos.
    has_all: bool,
}

#[pymethods]
impl ServoGroup {
    #[new]
    fn new(py: Python<'_>, port: Py<SerialPort>, codec: Py<ServoCodec>, servos: Vec<usize>, ids: Vec<u8>) -> Self {
        let has_all = (0..codec.borrow(py).core.size()).all(|servo| servos.contains(&servo));
        Self { port, codec, servos, ids, has_all }
    }

    #[doc = stub!(ServoGroup.read)]
    #[inline(never)]
    pub(crate) fn read<'py>(
        &self,
        py: Python<'py>,
        block: [usize; 2],
        timeout: f64,
        time: f64,
        longest: f64,
        usual: bool,
    ) -> PyResult<Bound<'py, PyAny>> {
        let replies = serial::read_registers(py, self.port.get(), serial::SYNC_READ, &self.ids, block, timeout)?;
        let mut notable = Vec::new();
        if replies.is_complete {
            // Borrow the codec only now: while the interpreter lock was released, another port may have used it.
            let mut codec = self.codec.bind(py).try_borrow_mut()?;
            let mut is_usual = usual;
            for (i, (&servo, (data, status))) in self.servos.iter().zip(replies.packets()).enumerate() {
                if let Some(found) = codec.store(servo, data, status, block[0], [time, longest])? {
                    notable.push((i, found));
                }
                is_usual = is_usual && codec.core.has_command(servo, data, block[0]).or_raise()?;
            }
            if is_usual && notable.is_empty() {
                return if self.has_all {
                    Ok(Py::new(py, codec.joints(&self.servos))?.into_bound(py).into_any())
                } else {
                    Ok(py.None().into_bound(py))
                };
            }
        }
        let found = (replies.to_python(py)?, PyList::new(py, notable)?);
        Ok(found.into_pyobject(py)?.into_any())
    }

    #[doc = stub!(ServoGroup.write)]
    #[expect(clippy::too_many_arguments, reason = "a command, and its packets")]
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 passes extracted arguments by value")]
    #[inline(never)]
    pub(crate) fn write(
        &self,
        py: Python<'_>,
        blocks: Vec<[usize; 2]>,
        timeout: f64,
        goal: &Bound<'_, PyAny>,
        limit: &Bound<'_, PyAny>,
        velocity: Option<&Bound<'_, PyAny>>,
        max_speed: f64,
    ) -> PyResult<()> {
        let mut codec = self.codec.bind(py).try_borrow_mut()?;
        codec.set_command(goal, limit, velocity)?;
        let mut data = [(); 2].map(|()| Vec::with_capacity(self.servos.len() * MAX_PACKET));
        let mut sent = Vec::with_capacity(self.servos.len());
        for servo in &self.servos {
            let ([goal, limit, _], sizes) = codec.encode_command(*servo, max_speed)?;
            sent.push((*servo, goal, limit, codec.packets[0], sizes[0]));
            for ((bytes, packet), size) in data.iter_mut().zip(&codec.packets).zip(sizes) {
                bytes.extend_from_slice(packet.get(..size).unwrap_or_default());
            }
        }
        // While the interpreter lock is released, another port may use the codec.
        drop(codec);
        for (block, bytes) in blocks.iter().zip(&data) {
            serial::write_registers(py, self.port.get(), &self.ids, *block, bytes, timeout)?;
        }
        let mut codec = self.codec.bind(py).try_borrow_mut()?;
        for (servo, goal, limit, packet, size) in sent {
            codec.core.record_sent(servo, Some(goal), limit, &packet[..size]).or_raise()?;
        }
        Ok(())
    }
}

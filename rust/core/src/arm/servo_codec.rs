//! Conversion between the registers of the servos on a bus and joint units, of all servos in one call.

use crate::error::{Error, Result};

/// Change of a servo's position that is accepted between two readings, however short the time between them [rad].
const JUMP_MARGIN: f64 = 0.1;
/// Ratio of the largest plausible speed of a servo, which a hand may push, to its no-load speed.
const PUSHED_SPEED: f64 = 2.0;
/// Gap between two readings above which the accepted change grows even after an implausible position [s]: the joint may
/// have moved in the gap.
const READING_GAP: f64 = 0.1;

/// Largest packet that writes registers [bytes].
pub const MAX_PACKET: usize = 32;

/// Register of a control table; little-endian.
#[derive(Debug, Clone, Copy, Default)]
pub struct Register {
    /// Address of the first byte.
    pub address: usize,
    /// Number of bytes; 0: the servo has no such register.
    pub size: usize,
    /// Coding of the sign: 0 unsigned; -1 two's complement; else magnitude, and the sign in the bit with this value.
    pub sign: i64,
}

impl Register {
    /// Returns the value in a block of bytes from address `start` on; `None` if the block does not contain it.
    #[inline(never)]
    fn decode(self, data: &[u8], start: usize) -> Option<i64> {
        let first = self.address.checked_sub(start)?;
        let bytes = data.get(first..first + self.size).filter(|bytes| !bytes.is_empty())?;
        let value = bytes.iter().rev().fold(0, |value, byte| value << 8 | i64::from(*byte));
        let top = 1 << (8 * bytes.len() - 1);
        Some(match self.sign {
            0 => value,
            -1 => (value ^ top) - top,
            bit if value & bit == 0 => value & (bit - 1),
            bit => -(value & (bit - 1)),
        })
    }

    /// Writes a value into a block of bytes from address `start` on, if the block contains the register.
    #[inline(never)]
    fn encode(self, value: i64, data: &mut [u8], start: usize) {
        let Some(first) = self.address.checked_sub(start) else { return };
        let Some(bytes) = data.get_mut(first..first + self.size) else { return };
        let value = if value < 0 && self.sign > 0 { -value | self.sign } else { value };
        for (byte, source) in bytes.iter_mut().zip(value.to_le_bytes()) {
            *byte = source;
        }
    }
}

/// Registers, units and bounds of a servo.
#[derive(Debug, Clone, Copy, Default)]
pub struct ServoUnits {
    /// Position, speed, load, current, voltage and temperature; goal, torque limit and speed cap; torque enable.
    pub registers: [Register; 10],
    /// Address and size of the block of each packet that writes goal, limit and speed cap; size 0: no such packet.
    pub packets: [[usize; 2]; 2],
    /// Position at joint angle 0 [counts].
    pub zero: f64,
    /// +1 if counts rise with the joint angle, else -1.
    pub sign: f64,
    /// Joint angle of one count [rad].
    pub count: f64,
    /// Joint velocity of one unit of the speed register [rad/s].
    pub velocity: f64,
    /// Joint torque of one unit of the register that measures it [N·m], and torque lost in the gears [N·m].
    pub measured: [f64; 2],
    /// 1 if the torque is computed from the register of the current, 0 if from the register of the load.
    pub uses_current: f64,
    /// One unit of the register of the current [A]; NaN without such a register.
    pub current: f64,
    /// Joint torque of one unit of the limit register [N·m], and torque lost in the gears [N·m].
    pub limit: [f64; 2],
    /// Largest value of the limit register, and the joint torque at this value [N·m].
    pub ceiling: [f64; 2],
    /// Largest value of the speed cap register.
    pub max_speed: f64,
    /// Joint speed without load [rad/s].
    pub no_load_speed: f64,
    /// Smallest and largest goal [counts].
    pub range: [f64; 2],
    /// Largest position of the encoder [counts].
    pub max_position: f64,
    /// Counts after which positions wrap around; 0 if they do not.
    pub turn: f64,
    /// 1 if goals may exceed one turn, else 0.
    pub multi_turn: f64,
    /// Smallest value of the voltage register that needs no attention.
    pub min_voltage: f64,
}

/// Last accepted reading of a servo.
#[derive(Debug, Clone, Copy, Default)]
pub struct ServoReading {
    /// Position without wrap-around [counts]; `None` before the first reading.
    pub position: Option<f64>,
    /// Whole turns that were added to the register.
    pub turns: f64,
    /// Time of the request [s].
    pub time: f64,
    /// Value of the register of the speed.
    pub speed: i64,
    /// Value of the register of the load.
    pub load: i64,
    /// Value of the register of the current; `None` without such a register.
    pub current: Option<i64>,
    /// Values of the registers of voltage and temperature; each `None` if the block does not contain it.
    pub supply: [Option<i64>; 2],
    /// Time of the last reading with a voltage of at least [`ServoUnits::min_voltage`] [s].
    pub supplied: f64,
}

/// Last command that was sent to a servo.
#[derive(Debug, Clone, Copy, Default)]
pub struct SentCommand {
    /// Value of the goal register; `None` before the first command.
    pub goal: Option<i64>,
    /// Value of the limit register.
    pub limit: i64,
    /// Number of commands so far.
    pub count: u32,
    /// First packet and its size [bytes]; size 0: unknown.
    packet: ([u8; MAX_PACKET], usize),
}

impl SentCommand {
    /// Returns the bytes of the first packet that wrote goal and limit; empty if they are unknown.
    pub fn packet(&self) -> &[u8] {
        &self.packet.0[..self.packet.1]
    }
}

/// A servo of a [`ServoCodec`].
#[derive(Debug, Clone, Default)]
struct Servo {
    joint: usize,
    units: ServoUnits,
    reading: ServoReading,
    sent: SentCommand,
    has_status: bool,
    /// Δt at the next reading [s], see [`ServoCodec`]; ∞: accept any position.
    allowed: f64,
    /// Time of the last reading, accepted or not [s].
    last: f64,
    rejected: u32,
    /// Distance of the latest implausible position from the last accepted one [rad].
    jump: f64,
}

impl Servo {
    fn angle(&self) -> f64 {
        let position = self.reading.position.unwrap_or(f64::NAN);
        self.units.sign * (position - self.units.zero) * self.units.count
    }

    /// Returns whole turns and unwrapped position for the value of a position register: nearest to the last position
    /// or, for the first reading of a multi-turn servo, to the middle of its range.
    fn unwrap(&self, raw: f64) -> (f64, f64) {
        let units = &self.units;
        if units.turn <= 0.0 {
            return (0.0, raw);
        }
        let [low, high] = units.range;
        let turns = if let Some(last) = self.reading.position {
            ((last - raw) / units.turn).round_ties_even()
        } else if units.multi_turn > 0.0 && !(low <= raw && raw <= high) {
            ((f64::midpoint(low, high) - raw) / units.turn).round_ties_even()
        } else {
            0.0
        };
        (turns, raw + turns * units.turn)
    }

    /// Returns true if the joint can have reached `position` [counts], `turns` included, at `time` [s].
    ///
    /// A single-turn servo that stands within its encoder cannot report another turn: goals at the end of its encoder
    /// would move it through its range.
    ///
    /// The accepted distance grows with the time since the last accepted position; after an implausible position, only
    /// with gaps of more than 0.1 s between readings.
    fn is_reachable(&mut self, position: f64, turns: f64, time: f64) -> bool {
        let Some(last) = self.reading.position else { return true };
        let gap = time - self.last;
        self.last = time;
        if self.rejected == 0 || gap > READING_GAP {
            self.allowed += gap;
        }
        let units = &self.units;
        let is_within = units.multi_turn <= 0.0 && (0.0..=units.max_position).contains(&position);
        let added = if is_within { turns.abs() * units.turn } else { 0.0 };
        let jump = ((position - last).abs() + added) * units.count;
        if added == 0.0 && jump <= (PUSHED_SPEED * units.no_load_speed).mul_add(self.allowed, JUMP_MARGIN) {
            (self.rejected, self.allowed) = (0, 0.0);
            return true;
        }
        (self.rejected, self.jump) = (self.rejected.saturating_add(1), jump);
        false
    }

    /// Returns the torque of the servo at the joint [N·m].
    fn torque(&self) -> f64 {
        let ([unit, lost], reading) = (self.units.measured, &self.reading);
        let register = if self.units.uses_current > 0.0 { reading.current.unwrap_or(0) } else { reading.load };
        let size = (register.unsigned_abs() as f64).mul_add(unit, -lost).max(0.0);
        if register < 0 { -self.units.sign * size } else { self.units.sign * size }
    }

    /// Returns goal, limit and speed cap registers for a goal [rad], torque limit [N·m] and speed [rad/s].
    fn command(&self, [goal, limit, speed]: [f64; 3]) -> [f64; 3] {
        let (units, turns, position) = (&self.units, self.reading.turns, self.reading.position);
        let counts = (units.zero + units.sign * goal / units.count).round_ties_even();
        let [low, high] = units.range;
        let goal = if units.multi_turn > 0.0 {
            // If the servo stands outside the range, extend the range to its present position.
            let here = position.map(f64::round_ties_even);
            counts.min(here.map_or(high, |here| high.max(here))).max(here.map_or(low, |here| low.min(here)))
                - turns * units.turn
        } else if turns > 0.0 {
            // Past the seam of a single-turn encoder, the goal is the end of the encoder at which the servo stands.
            0.0
        } else if turns < 0.0 {
            units.max_position
        } else {
            counts.min(high).max(low)
        };
        let ([unit, lost], [ceiling, usable]) = (units.limit, units.ceiling);
        let torque = limit.min(usable);
        // The tolerance makes the conversion of a register to its torque and back exact.
        let counts = ((torque + lost) / unit).mul_add(1.0 + 1e-12, 1e-9).floor().min(ceiling).max(0.0);
        let speed = (speed.abs() / units.velocity.abs()).floor().min(units.max_speed).max(1.0);
        [goal, if torque > 0.0 { counts } else { 0.0 }, speed]
    }
}

/// Result of [`ServoCodec::decode`] for a reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decoded {
    /// The reading is stored and needs no attention.
    Usual,
    /// The reading is stored and needs attention: the status byte or the turns are not 0 or were not 0 before, the
    /// voltage is too low, voltage or temperature has changed, or it is the first reading or follows
    /// [`ServoCodec::accept_any`].
    Notable,
    /// The position is implausible, and the reading is not stored.
    Implausible,
}

/// Converts the registers of the servos of n joints to joint units and back, and rejects implausible positions.
///
/// A position is accepted if it lies within `2 v₀ Δt + 0.1 rad` of the last accepted one, with the no-load speed v₀
/// [rad/s] and the time Δt since that position [s]. After an implausible position, only gaps of more than 0.1 s between
/// readings count as part of Δt, so that a lasting jump of an encoder stays rejected.
#[derive(Debug, Clone)]
pub struct ServoCodec {
    servos: Vec<Servo>,
    joints: Vec<[f64; 5]>,
    ok: Vec<bool>,
}

impl ServoCodec {
    /// Creates a codec of a number of servos on n joints; [`ServoCodec::configure`] must be called for each servo.
    pub fn new(servos: usize, n: usize) -> Self {
        Self { servos: vec![Servo::default(); servos], joints: vec![[0.0; 5]; n], ok: vec![false; n] }
    }

    fn servo(&self, servo: usize) -> Result<&Servo> {
        self.servos.get(servo).ok_or_else(|| unknown("servo", servo))
    }

    fn servo_mut(&mut self, servo: usize) -> Result<&mut Servo> {
        self.servos.get_mut(servo).ok_or_else(|| unknown("servo", servo))
    }

    /// Sets joint and units of a servo. The servos of one joint must have consecutive indices; the lowest index is its
    /// first servo.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if there is no such servo or joint.
    pub fn configure(&mut self, servo: usize, joint: usize, units: &ServoUnits) -> Result<()> {
        if joint >= self.joints.len() {
            return Err(unknown("joint", joint));
        }
        let servo = self.servo_mut(servo)?;
        (servo.joint, servo.units) = (joint, *units);
        Ok(())
    }

    /// Returns the joint of a servo.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if there is no such servo.
    pub fn joint(&self, servo: usize) -> Result<usize> {
        self.servo(servo).map(|servo| servo.joint)
    }

    /// Returns the last accepted reading of a servo, the number of implausible positions since, and the distance of the
    /// last of these [rad].
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if there is no such servo.
    pub fn reading(&self, servo: usize) -> Result<(ServoReading, u32, f64)> {
        self.servo(servo).map(|servo| (servo.reading, servo.rejected, servo.jump))
    }

    /// Accepts any position in the next reading of a servo. Stores position [counts], turns and time [s] as its last
    /// reading, unless the position is NaN.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if there is no such servo.
    pub fn accept_any(&mut self, servo: usize, [position, turns, time]: [f64; 3]) -> Result<()> {
        let servo = self.servo_mut(servo)?;
        servo.allowed = f64::INFINITY;
        if !position.is_nan() {
            (servo.reading.position, servo.reading.turns, servo.reading.time) = (Some(position), turns, time);
        }
        Ok(())
    }

    /// Decodes and stores a reading of a servo: a block of bytes from `address` on, requested at `time` [s].
    /// `has_status` is true if the status byte of the reply is not 0.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if there is no such servo; [`Error::Shape`] if the block has no position.
    pub fn decode(
        &mut self,
        servo: usize,
        data: &[u8],
        address: usize,
        has_status: bool,
        time: f64,
    ) -> Result<Decoded> {
        let servo = self.servo_mut(servo)?;
        let mut values = [None; 6];
        for (value, register) in values.iter_mut().zip(&servo.units.registers) {
            *value = register.decode(data, address);
        }
        let [position, speed, load, current, voltage, temperature] = values;
        let Some(position) = position else { return Err(Error::length("position", data.len(), address)) };
        let (turns, position) = servo.unwrap(position as f64);
        let (before, supply) = (servo.reading, [voltage, temperature]);
        let accepts_any = before.position.is_none() || servo.allowed.is_infinite();
        if accepts_any {
            (servo.rejected, servo.allowed, servo.last) = (0, 0.0, time);
        } else if !servo.is_reachable(position, turns, time) {
            return Ok(Decoded::Implausible);
        }
        let is_supplied = voltage.is_none_or(|voltage| voltage as f64 >= servo.units.min_voltage);
        servo.reading = ServoReading {
            position: Some(position),
            turns,
            time,
            speed: speed.unwrap_or(0),
            load: load.unwrap_or(before.load),
            current: current.or(before.current),
            supply,
            supplied: if is_supplied { time } else { before.supplied },
        };
        let has_turns = turns.abs() + before.turns.abs() > 0.5;
        let is_notable =
            accepts_any || has_turns || has_status || servo.has_status || !is_supplied || supply != before.supply;
        servo.has_status = has_status;
        Ok(if is_notable { Decoded::Notable } else { Decoded::Usual })
    }

    /// Returns false if a block of bytes from `address` on shows that torque is off, or that the registers do not
    /// contain the first packet of the last command. Returns true if the block lacks the register torque enable.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if there is no such servo.
    pub fn has_command(&self, servo: usize, data: &[u8], address: usize) -> Result<bool> {
        let servo = self.servo(servo)?;
        let Some(torque_enable) = servo.units.registers[9].decode(data, address) else { return Ok(true) };
        let packet = servo.sent.packet();
        let written =
            servo.units.packets[0][0].checked_sub(address).and_then(|start| data.get(start..start + packet.len()));
        Ok(torque_enable == 1 && !packet.is_empty() && written == Some(packet))
    }

    /// Returns the number of servos.
    pub fn size(&self) -> usize {
        self.servos.len()
    }

    /// Returns the reading of each of the n joints: angle [rad], NaN before the first; time [s]; velocity [rad/s];
    /// torque [N·m]; current [A], NaN without such a register. Also returns, for each joint, true if all its servos are
    /// in `read`.
    ///
    /// A joint with two servos has the angle and the velocity of the first, or the angle of the second while the first
    /// has none; the time of the older reading; the mean of the torques; and the sum of the currents.
    pub fn joints(&mut self, read: &[usize]) -> (&[[f64; 5]], &[bool]) {
        let mut last = usize::MAX;
        for (i, servo) in self.servos.iter().enumerate() {
            let (joint, units, reading) = (servo.joint, &servo.units, &servo.reading);
            let current = units.current * reading.current.map_or(f64::NAN, |current| current.unsigned_abs() as f64);
            let (values, ok, is_read) = (&mut self.joints[joint], &mut self.ok[joint], read.contains(&i));
            if joint == last {
                let angle = if values[0].is_nan() { servo.angle() } else { values[0] };
                // Two servos of a joint count as one with the mean of their torques.
                let torque = 0.5 * (values[3] + servo.torque());
                *values = [angle, values[1].min(reading.time), values[2], torque, values[4] + current];
                *ok &= is_read;
            } else {
                let velocity = units.sign * reading.speed as f64 * units.velocity;
                *values = [servo.angle(), reading.time, velocity, servo.torque(), current];
                *ok = is_read;
            }
            last = joint;
        }
        (&self.joints, &self.ok)
    }

    /// Checks a command for all n joints: goals [rad], torque limits [N·m] and largest speeds [rad/s].
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if a goal or limit is not finite, a speed is NaN, or a limit or speed is negative.
    pub fn check_command(&self, command: [&[f64]; 3]) -> Result<()> {
        let [goals, limits, speeds] = command;
        for ((&goal, &limit), &speed) in goals.iter().zip(limits).zip(speeds) {
            if !(goal.is_finite() && limit.is_finite() && limit >= 0.0 && speed >= 0.0) {
                let row = [goal, limit, speed];
                let value = row.into_iter().find(|value| !value.is_finite()).unwrap_or(limit.min(speed));
                return Err(Error::out_of_range("command", value, "finite goals, and limits and speeds of at least 0"));
            }
        }
        Ok(())
    }

    /// Returns goal, limit and speed cap registers of a servo for a valid command: goal [rad], torque limit [N·m] and
    /// largest speed [rad/s]. Writes its packets to `packets`, whose lengths it returns.
    ///
    /// The speed is bounded by `max_speed` [rad/s], or by the joint's speed without load if `max_speed` is 0.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if there is no such servo.
    #[expect(clippy::cast_possible_truncation, reason = "registers are whole numbers within their bounds")]
    pub fn encode(
        &self,
        servo: usize,
        command: [f64; 3],
        max_speed: f64,
        packets: &mut [[u8; MAX_PACKET]; 2],
    ) -> Result<([i64; 3], [usize; 2])> {
        let servo = self.servo(servo)?;
        let [goal, limit, speed] = command;
        let first = self.servos.iter().find(|other| other.joint == servo.joint).unwrap_or(servo);
        let bound = if max_speed > 0.0 { max_speed } else { first.units.no_load_speed };
        let values = servo.command([goal, limit, speed.min(bound)]).map(|value| value as i64);
        let blocks = &servo.units.packets;
        for (bytes, &[address, size]) in packets.iter_mut().zip(blocks) {
            *bytes = [0; MAX_PACKET];
            for (register, value) in servo.units.registers[6..9].iter().zip(values) {
                register.encode(value, &mut bytes[..size.min(MAX_PACKET)], address);
            }
        }
        Ok((values, [blocks[0][1].min(MAX_PACKET), blocks[1][1].min(MAX_PACKET)]))
    }

    /// Returns the last command that was sent to a servo.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if there is no such servo.
    pub fn sent(&self, servo: usize) -> Result<&SentCommand> {
        self.servo(servo).map(|servo| &servo.sent)
    }

    /// Records that a command was sent to a servo: values of goal and limit register, and the first packet (empty:
    /// unknown).
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if there is no such servo; [`Error::Shape`] if the packet is longer than [`MAX_PACKET`].
    pub fn record_sent(&mut self, servo: usize, goal: Option<i64>, limit: i64, packet: &[u8]) -> Result<()> {
        let sent = &mut self.servo_mut(servo)?.sent;
        let Some(bytes) = sent.packet.0.get_mut(..packet.len()) else {
            return Err(Error::length("packet", packet.len(), MAX_PACKET));
        };
        bytes.copy_from_slice(packet);
        (sent.goal, sent.limit, sent.packet.1) = (goal, limit, packet.len());
        sent.count = sent.count.wrapping_add(1);
        Ok(())
    }
}

#[cold]
fn unknown(what: &str, index: usize) -> Error {
    Error::out_of_range(what, index as f64, "those of the codec")
}

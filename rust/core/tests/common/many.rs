//! Inputs and outputs of batch steps, and the single steps to compare them with.

use pliant_core::{BatchCommand, BatchInput, Controller, Model, Pose, StepInput, Targets};

use crate::seeded::Random;

/// Number of arms: enough for more than two chunks of a batch, the last of them incomplete.
pub(crate) const ARMS: usize = 150;

/// Output arrays of a batch step: goals, torque limits, speeds.
pub(crate) struct Out(pub(crate) [Vec<f64>; 3]);

impl Out {
    pub(crate) fn new(count: usize, n: usize) -> Self {
        Self([vec![-7.0; count * n], vec![-7.0; count * n], vec![-7.0; count * n]])
    }

    pub(crate) fn command(&mut self) -> BatchCommand<'_> {
        let [goal, torque_limit, velocity] = &mut self.0;
        BatchCommand { goal, torque_limit, velocity }
    }

    pub(crate) fn row(&self, row: usize, n: usize) -> [Vec<u64>; 3] {
        self.0.each_ref().map(|all| bits(&all[row * n..][..n]))
    }
}

pub(crate) fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|value| value.to_bits()).collect()
}

pub(crate) fn single(controller: &mut Controller, q: &[f64], target: &Pose, input: &StepInput<'_>) -> [Vec<u64>; 3] {
    let command = controller.step(q, target, input).unwrap();
    [bits(command.goal()), bits(command.torque_limit()), bits(command.speed_limit())]
}

/// Positions and targets of many arms: random, at the limits, slightly beyond them, stretched out, and at rest.
pub(crate) struct Arms {
    pub(crate) q: Vec<f64>,
    pub(crate) poses: Vec<Pose>,
    pub(crate) flat: Vec<f64>,
    pub(crate) dq: Vec<f64>,
}

impl Arms {
    pub(crate) fn new(random: &mut Random, model: &Model, count: usize) -> Self {
        let (mut q, mut poses, mut flat) = (Vec::new(), Vec::new(), Vec::new());
        for row in 0..count {
            let at = match row % 5 {
                0 => vec![0.0; model.n()],
                1 => {
                    let far = random.joints(model, 3.0);
                    let (low, high) = (model.lower(), model.upper());
                    far.iter().zip(low.iter().zip(high)).map(|(q, (l, h))| q.clamp(l - 0.01, h + 0.01)).collect()
                }
                _ => random.joints(model, 0.9),
            };
            let (metres, radians) = random.pick(&[(0.0, 0.0), (0.05, 0.2), (0.5, 2.0)]);
            let pose = random.target(model, &at, metres, radians);
            flat.extend(pose.to_rows().into_iter().flatten());
            q.extend(at);
            poses.push(pose);
        }
        Self { dq: random.vector(q.len(), 1.0), q, poses, flat }
    }

    pub(crate) fn input(&self, dt: Option<f64>, with_dq: bool) -> BatchInput<'_> {
        BatchInput { dt, dq: with_dq.then_some(&self.dq), ..BatchInput::new(&self.q, Targets::Poses(&self.flat)) }
    }
}

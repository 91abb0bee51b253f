//! Bounds on commands for every input, and continuity: a small change of the reading changes the command only slightly.

use std::sync::Arc;

use pliant_core::params::{Axis, CompliantSide, Follow, Law, LimitRule, PaperOptions, Task, TorqueLimits, Tracking};
use pliant_core::{Controller, Model, ModelOptions, Pose, Servos, Settings, StepInput};

use crate::cases;
use crate::seeded::{self, Random};

fn arm(index: usize) -> Arc<Model> {
    seeded::arm(index, &ModelOptions::default())
}

fn open() -> Settings {
    Settings {
        max_tool_speed: [f64::INFINITY; 2],
        tracking: Tracking { goal_slew: f64::INFINITY, ..Tracking::default() },
        torque_limits: TorqueLimits { stiffening_time: 0.0, ..TorqueLimits::default() },
        ..Settings::default()
    }
}

#[test]
fn forces_and_torque_limits_stay_within_their_bounds() {
    let mut random = Random::new(21);
    let (mut soft_ticks, mut stiff_ticks) = (0, 0);
    for round in 0..600 {
        let index = round % 3;
        let model = arm(index);
        let n = model.n();
        let settings =
            cases::settings(&mut random, &model, [Law::Cap, Law::Paper, Law::Impedance, Law::Paper][round % 4]);
        let servos = cases::servos(&mut random, &seeded::servos(index), n);
        let settings = cases::accepted_settings(&model, settings, Some(&servos));
        let mut controller = Controller::new(Arc::clone(&model), settings.clone(), Some(servos.clone())).unwrap();
        let mut q = random.joints(&model, 1.0);
        let target = random.target(&model, &q, 0.3, 1.0);
        controller.reset(&q).unwrap();
        for _ in 0..10 {
            for value in &mut q {
                *value += random.between(-0.02, 0.02);
            }
            let command = *controller.step(&q, &target, &StepInput::default()).unwrap();
            for i in 0..n {
                let floor = settings.torque_limits.floor.as_ref().map_or(servos.friction[i], |f| f[i]);
                let limit = command.torque_limit()[i];
                assert!(limit <= servos.max_torque[i] && limit >= floor.min(servos.max_torque[i]) - 1e-12, "{limit}");
                let (goal, out) = (command.goal()[i], servos.max_torque[i] / servos.kp[i] + 1e-12);
                assert!(goal >= model.lower()[i] - out && goal <= model.upper()[i] + out);
                assert!(command.speed_limit()[i] > 0.0);
            }
            let record = controller.diagnostics();
            for r in 0..controller.task_dim() {
                if settings.law == Law::Impedance && !record.locked.contains(&true) {
                    stiff_ticks += 1;
                    assert!(record.wrench[r].abs() <= record.axis_strength[r] * (1.0 + 1e-12));
                }
                let free = settings.effective_follow() == Follow::Free && settings.law == Law::Cap;
                if free && record.softness[r] >= 1.0 {
                    soft_ticks += 1;
                    assert!(record.wrench[r].abs() <= record.axis_strength[r] * (1.0 + 1e-12));
                }
            }
        }
    }
    assert!(soft_ticks > 1000 && stiff_ticks > 1000, "{soft_ticks} {stiff_ticks}");
}

#[test]
fn the_reference_moves_within_its_bounds() {
    let model = arm(0);
    let mut random = Random::new(22);
    // Strong servos and goals without a speed limit, so that only the bounds under test limit the reference.
    let settings = Settings {
        max_tool_speed: [0.2, 0.8],
        max_tool_acceleration: [1.5, 5.0],
        tracking: Tracking { goal_slew: f64::INFINITY, ..Tracking::default() },
        ..Settings::default()
    };
    let mut servos = seeded::servos(0);
    servos.max_torque.iter_mut().for_each(|torque| *torque *= 100.0);
    let mut controller = Controller::new(Arc::clone(&model), settings, Some(servos)).unwrap();
    let q = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657];
    controller.reset(&q).unwrap();
    let tool = model.forward_kinematics(&q).unwrap();
    let (mut target, mut before, mut slow) = (tool, [0.0; 3], tool);
    let mut last = controller.diagnostics().deviation;
    for tick in 0..2000 {
        if tick % 100 == 0 {
            target = random.target(&model, &q, 0.3, 1.5);
        }
        controller.step(&q, &target, &StepInput::default()).unwrap();
        let now = controller.diagnostics().deviation;
        let velocity: [f64; 3] = std::array::from_fn(|i| (now[i] - last[i]) / 0.01);
        let size = |v: &[f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        let change: [f64; 3] = std::array::from_fn(|i| (velocity[i] - before[i]) / 0.01);
        assert!(size(&velocity) <= 0.2 * (1.0 + 1e-9), "tick {tick}: {velocity:?}");
        assert!(size(&change) <= 1.5 * (1.0 + 1e-6), "tick {tick}: {change:?}");
        (before, last) = (velocity, now);
    }
    // The reference equals a target that moves within the bounds.
    controller.reset(&q).unwrap();
    for tick in 0..200 {
        slow.position[1] = tool.position[1] + 0.05 * (1.0 - (0.02 * f64::from(tick)).cos());
        controller.step(&q, &slow, &StepInput::default()).unwrap();
        let lag = controller.diagnostics().deviation[1] - (slow.position[1] - tool.position[1]);
        assert!(lag.abs() < 1e-9, "tick {tick}: lags {lag}");
    }
}

/// The reference of a blocked arm stops near the arm if the target is far, and reaches a target that is near.
#[test]
fn the_reference_waits_for_a_blocked_arm_whose_target_is_far() {
    let model = arm(0);
    let q = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657];
    let tool = model.forward_kinematics(&q).unwrap();
    let lead = |distance: f64| {
        let mut controller = Controller::new(Arc::clone(&model), Settings::default(), Some(seeded::servos(0))).unwrap();
        let mut target = tool;
        target.position[1] += distance;
        for _ in 0..400 {
            controller.step(&q, &target, &StepInput::default()).unwrap();
        }
        let reference = controller.diagnostics().reference;
        reference.position[1] - tool.position[1]
    };
    let (near, far) = (lead(0.04), lead(0.4));
    assert!((near - 0.04).abs() < 1e-12 && far > 0.04 && far < 0.2, "{near} {far}");
}

/// Runs single steps from rest in given positions.
struct Probe {
    controller: Controller,
    target: Pose,
}

impl Probe {
    fn at(&self, q: &[f64]) -> (Vec<f64>, Controller) {
        let mut controller = self.controller.clone();
        controller.reset(q).unwrap();
        let posture = vec![0.1; q.len()];
        let input = StepInput { posture: Some(&posture), ..StepInput::default() };
        let command = *controller.step(q, &self.target, &input).unwrap();
        // Divide torque limits by a stiffness, so that they are comparable with goals [rad].
        let limits = command.torque_limit().iter().map(|t| t / 60.0);
        (command.goal().iter().copied().chain(limits).collect(), controller)
    }

    /// Returns the largest jump of the command between `a` and `b`: bisects the interval 24 times, each time toward the
    /// half with the larger change.
    fn jump(&self, a: &[f64], b: &[f64]) -> f64 {
        let between = |s: f64| a.iter().zip(b).map(|(x, y)| x + s * (y - x)).collect::<Vec<_>>();
        let (mut low, mut high) = (0.0, 1.0);
        let (mut at_low, mut at_high) = (self.at(&between(low)).0, self.at(&between(high)).0);
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            let at_middle = self.at(&between(middle)).0;
            if distance(&at_low, &at_middle) > distance(&at_middle, &at_high) {
                (high, at_high) = (middle, at_middle);
            } else {
                (low, at_low) = (middle, at_middle);
            }
        }
        distance(&at_low, &at_high)
    }
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).fold(0.0, |max_jump, (x, y)| max_jump.max((x - y).abs()))
}

/// Moves from `a` to `b` in small steps; returns each jump above `max_jump`, with two flags: joints were locked there,
/// and torques were scaled there.
fn jumps(probe: &Probe, a: &[f64], b: &[f64], max_jump: f64) -> Vec<(f64, bool, bool)> {
    let steps: usize = 60;
    let at = |s: usize| a.iter().zip(b).map(|(x, y)| x + (y - x) * s as f64 / steps as f64).collect::<Vec<_>>();
    let mut all_jumps = Vec::new();
    let mut before = probe.at(&at(0)).0;
    for s in 1..=steps {
        let (now, controller) = probe.at(&at(s));
        if distance(&before, &now) > 2.0 * max_jump {
            let size = probe.jump(&at(s - 1), &at(s));
            if size > max_jump {
                let earlier = probe.at(&at(s - 1)).1;
                let locked = |c: &Controller| c.diagnostics().locked.contains(&true);
                let scaled = |c: &Controller| c.diagnostics().factors.iter().any(|f| *f < 1.0);
                all_jumps.push((
                    size,
                    locked(&controller) || locked(&earlier),
                    scaled(&controller) || scaled(&earlier),
                ));
            }
        }
        before = now;
    }
    all_jumps
}

fn one_sided(yields: CompliantSide, axis: &str) -> Settings {
    let mut settings =
        Settings { paper_options: PaperOptions { limits: LimitRule::Demand, ..open().paper_options }, ..open() };
    let adaptation = if yields == CompliantSide::None { 0.0 } else { 0.9 };
    let given =
        Axis { soft: Some([0.5, 1.0]), firm: Some([2.0, 1.5]), yields: Some(yields), adaptation, ..Axis::default() };
    settings.set_axes(axis, given).unwrap();
    settings
}

#[test]
fn commands_are_continuous() {
    let mut random = Random::new(23);
    let (mut all_jumps, mut paths) = (Vec::new(), 0);
    for round in 0..80 {
        let index = [0, 1][round % 2];
        let model = arm(index);
        let yields = [CompliantSide::Plus, CompliantSide::Minus, CompliantSide::Both, CompliantSide::None][round % 4];
        let follow = [None, Some(Follow::Hold)][usize::from(round % 5 == 0)];
        let settings = Settings {
            paper_options: PaperOptions {
                follow,
                ..one_sided(yields, ["y", "z", "yaw", "xyz"][(round / 4) % 4]).paper_options
            },
            ..one_sided(yields, ["y", "z", "yaw", "xyz"][(round / 4) % 4])
        };
        let controller = Controller::new(Arc::clone(&model), settings, Some(seeded::servos(index))).unwrap();
        let middle = random.joints(&model, 0.5);
        // The target is on the path, so that every deviation changes its sign.
        let probe = Probe { controller, target: model.forward_kinematics(&middle).unwrap() };
        let direction = random.vector(7, 0.05);
        let (a, b): (Vec<f64>, Vec<f64>) = middle.iter().zip(&direction).map(|(m, w)| (m - w, m + w)).unzip();
        all_jumps.extend(jumps(&probe, &a, &b, 1e-4));
        paths += 1;
    }
    assert!(paths == 80 && all_jumps.is_empty(), "{all_jumps:?}");
}

#[test]
fn commands_are_continuous_when_joints_reach_limits() {
    let mut random = Random::new(24);
    for (soft, follow) in [(false, Follow::Free), (true, Follow::Free), (true, Follow::Hold)] {
        let (mut all_jumps, mut onsets) = (Vec::new(), 0);
        for _ in 0..30 {
            let model = arm(0);
            let mut settings =
                Settings { paper_options: PaperOptions { follow: Some(follow), ..open().paper_options }, ..open() };
            if soft {
                settings = Settings {
                    paper_options: PaperOptions {
                        follow: Some(follow),
                        ..one_sided(CompliantSide::Both, "y").paper_options
                    },
                    ..one_sided(CompliantSide::Both, "y")
                };
            }
            // Servos so strong that torques do not reach their ceilings; `jumps_at_torque_ceilings_are_small` tests
            // those.
            let strong = Servos { max_torque: vec![1e3], ..seeded::servos(0) };
            let controller = Controller::new(Arc::clone(&model), settings, Some(strong)).unwrap();
            // One joint moves to its limit.
            let mut a = random.joints(&model, 0.5);
            let joint = random.below(7);
            let mut b = a.clone();
            (a[joint], b[joint]) = (model.upper()[joint] - 0.15, model.upper()[joint]);
            let mut beyond = b.clone();
            beyond[joint] += 0.03;
            let probe = Probe { controller, target: random.target(&model, &beyond, 0.01, 0.03) };
            let locked = |q: &[f64]| probe.at(q).1.diagnostics().locked.contains(&true);
            onsets += usize::from(!locked(&a) && locked(&b));
            all_jumps.extend(jumps(&probe, &a, &b, 1e-4));
        }
        assert!(onsets >= 3 && all_jumps.is_empty(), "soft {soft}, {follow:?}: {onsets} onsets, {all_jumps:?}");
    }
}

#[test]
fn commands_of_tasks_with_few_axes_are_continuous() {
    let mut random = Random::new(25);
    let model = arm(2);
    let mut all_jumps = Vec::new();
    for round in 0..40 {
        let mut settings = Settings { task: Task::parse(["xyz", "x z pitch"][round % 2]).unwrap(), ..open() };
        settings.set_axes("z", Axis { yields: Some(CompliantSide::Plus), adaptation: 0.9, ..Axis::default() }).unwrap();
        let controller = Controller::new(Arc::clone(&model), settings, Some(seeded::servos(2))).unwrap();
        let middle = random.joints(&model, 0.5);
        let probe = Probe { controller, target: model.forward_kinematics(&middle).unwrap() };
        let direction = random.vector(5, 0.05);
        let (a, b): (Vec<f64>, Vec<f64>) = middle.iter().zip(&direction).map(|(m, w)| (m - w, m + w)).unzip();
        all_jumps.extend(jumps(&probe, &a, &b, 1e-4));
    }
    assert!(all_jumps.is_empty(), "{all_jumps:?}");
}

#[test]
fn jumps_at_torque_ceilings_are_small() {
    // The soft part is reduced before the stiff part. If it changes its sign in a saturated joint, it returns in one
    // step.
    let mut random = Random::new(26);
    let mut all_jumps = Vec::new();
    for round in 0..60 {
        let model = arm(0);
        let yields = [CompliantSide::Plus, CompliantSide::Both][round % 2];
        let settings = one_sided(yields, ["y", "z", "yaw", "xyz"][(round / 4) % 4]);
        let controller = Controller::new(Arc::clone(&model), settings, Some(seeded::servos(0))).unwrap();
        let middle = random.joints(&model, 0.4);
        let probe = Probe { controller, target: random.target(&model, &middle, 0.1, 0.4) };
        let direction = random.vector(7, 0.05);
        let (a, b): (Vec<f64>, Vec<f64>) = middle.iter().zip(&direction).map(|(m, w)| (m - w, m + w)).unzip();
        all_jumps.extend(jumps(&probe, &a, &b, 1e-4));
    }
    assert!(all_jumps.iter().all(|(size, _, scaled)| *scaled && *size < 0.015), "{all_jumps:?}");
}

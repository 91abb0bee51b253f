//! Properties of activation, projector, inverse, signs and gradients that hold for every pose and target.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};
use pliant_core::equations::{damped_pseudo_inverse, null_space_projector};
use pliant_core::params::{
    Axis, CompliantSide, Damping, Frame, Law, NullSpace, PaperOptions, Projector, Task, TorqueLimits, Tracking,
};
use pliant_core::{Controller, Model, ModelOptions, Pose, Settings, StepInput};

use crate::common;
use crate::seeded::{self, Random};

const NAMES: [&str; 6] = ["x", "y", "z", "roll", "pitch", "yaw"];

fn arm(index: usize) -> Arc<Model> {
    seeded::arm(index, &ModelOptions::default())
}

/// Settings without speed limits, so that a single step shows the law's unlimited result.
fn open() -> Settings {
    Settings {
        max_tool_speed: [f64::INFINITY; 2],
        tracking: Tracking { goal_slew: f64::INFINITY, ..Tracking::default() },
        torque_limits: TorqueLimits { stiffening_time: 0.0, ..TorqueLimits::default() },
        ..Settings::default()
    }
}

fn paper() -> Settings {
    Settings {
        law: Law::Paper,
        gravity: false,
        torque_limits: TorqueLimits { floor: Some(vec![0.0; 7]), ..open().torque_limits },
        ..open()
    }
}

fn make(index: usize, settings: Settings) -> Controller {
    Controller::new(arm(index), settings, Some(seeded::servos(index))).unwrap()
}

/// Returns random postures in the joint ranges, some nearly and some exactly singular.
fn poses(model: &Model, count: usize, seed: u64) -> Vec<Vec<f64>> {
    let mut random = Random::new(seed);
    (0..count)
        .map(|round| {
            let mut q = random.joints(model, 0.9);
            let shrink = [1.0, 1.0, 1e-3, 1e-9, 0.0][round % 5];
            q.iter_mut().skip(1).for_each(|value| *value *= shrink);
            q
        })
        .collect()
}

#[test]
fn columns_of_the_activation_sum_to_one_in_the_step() {
    for axes in ["all", "xyz", "y yaw"] {
        let mut controller = make(
            0,
            Settings {
                task: Task::parse(axes).unwrap(),
                null_space: NullSpace { posture: Some(vec![0.1; 7]), ..paper().null_space },
                ..paper()
            },
        );
        let model = arm(0);
        for q in poses(&model, 200, 1) {
            let target = Random::new(9).target(&model, &q, 0.1, 0.5);
            controller.reset(&q).unwrap();
            let limit = controller.step(&q, &target, &StepInput::default()).unwrap().torque_limit().to_vec();
            let a = controller.activation();
            assert!(a.iter().all(|&share| share >= 0.0));
            for column in a.column_iter() {
                assert!((column.sum() - 1.0).abs() < 1e-12, "{axes}: {}", column.sum());
            }
            // Equation (11) of the paper distributes the budgets over the joints and preserves their sum.
            let record = controller.diagnostics();
            let budget: f64 = record.axis_strength.iter().take(controller.task_dim()).sum::<f64>() + 2.0;
            let ceiling = [10.7, 10.7, 10.7, 10.7, 6.4, 6.4, 6.4];
            if limit.iter().zip(ceiling).all(|(l, c)| *l < c) {
                assert!((limit.iter().sum::<f64>() - budget).abs() < 1e-10);
            }
            // The activation does not depend on the magnitude of Δx.
            let other = Random::new(10).target(&model, &q, 0.01, 0.02);
            controller.reset(&q).unwrap();
            let locked = controller.diagnostics().locked;
            controller.step(&q, &other, &StepInput::default()).unwrap();
            if locked != controller.diagnostics().locked {
                continue;
            }
            let difference = (controller.activation() - a).amax();
            assert!(difference < 1e-10, "{axes}: {difference}");
        }
    }
}

#[test]
fn without_redundancy_the_null_column_is_zero() {
    let settings = Settings {
        task: Task::parse("xyz pitch roll").unwrap(),
        torque_limits: TorqueLimits { floor: None, ..paper().torque_limits },
        ..paper()
    };
    let mut controller = make(2, settings.clone());
    let q = [0.2, -0.3, 0.3, 0.9, 0.1];
    controller.step(&q, &arm(2).forward_kinematics(&q).unwrap(), &StepInput::default()).unwrap();
    assert!(controller.activation().column(5).iter().all(|&share| share.abs() < f64::MIN_POSITIVE));
    let asked = Settings { null_space: NullSpace { max_torque: Some(1.0), ..settings.null_space }, ..settings };
    assert!(Controller::new(arm(2), asked, Some(seeded::servos(2))).is_err());
}

#[test]
fn the_exact_projector_moves_no_task_axis() {
    let mut random = Random::new(3);
    for index in [0, 1] {
        let model = arm(index);
        for _ in 0..200 {
            let q = random.joints(&model, 0.9);
            let jacobian = model.jacobian(&q, pliant_core::Reference::WorldAligned).unwrap();
            let rows = 1 + random.below(6);
            let j = DMatrix::from_fn(rows, 7, |r, i| jacobian[(r, i)]);
            let sigma = j.singular_values();
            if sigma.min() < 5e-3 * sigma.max() {
                continue;
            }
            let n = null_space_projector(&j, 0.0, Projector::Exact).unwrap();
            assert!((&j * &n).amax() < 1e-10 && (&n * &n - &n).amax() < 1e-10 && (&n - n.transpose()).amax() < 1e-12);
        }
    }
    // In the control step, the null-space part of the goal does not move the tool to first order.
    let model = arm(0);
    for frame in [Frame::Base, Frame::Tool] {
        let task = Task { frame, ..Task::parse("xyz rpy").unwrap() };
        let mut controller = make(0, Settings { task, gravity: false, ..open() });
        for _ in 0..100 {
            let q = random.joints(&model, 0.8);
            let gradient = random.vector(7, 1.0);
            let target = model.forward_kinematics(&q).unwrap();
            controller.reset(&q).unwrap();
            let input = StepInput { gradient: Some(&gradient), ..StepInput::default() };
            let goal = controller.step(&q, &target, &input).unwrap().goal().to_vec();
            if controller.sigma_range()[0] > 0.01 && !controller.diagnostics().locked.contains(&true) {
                let lead = DVector::from_fn(7, |i, _| goal[i] - q[i]);
                assert!((controller.task_jacobian() * &lead).amax() < 1e-10);
                let torque: f64 = (0..7).map(|i| [150.0, 60.0][usize::from(i > 3)] * lead[i].abs()).sum();
                assert!(torque <= 2.0 + 1e-9, "Σ k_p |null| = {torque}");
            }
        }
    }
}

#[test]
fn the_damped_inverse_is_bounded() {
    let mut random = Random::new(4);
    let model = arm(0);
    for (round, q) in poses(&model, 200, 4).iter().enumerate() {
        let jacobian = model.jacobian(q, pliant_core::Reference::WorldAligned).unwrap();
        let rows = 1 + round % 6;
        let j = DMatrix::from_fn(rows, 7, |r, i| jacobian[(r, i)]);
        let lambda = random.scale(1e-4, 1.0);
        let pinv = damped_pseudo_inverse(&j, lambda).unwrap();
        assert!(pinv.singular_values().max() <= 0.5 / lambda * (1.0 + 1e-9));
    }
}

#[test]
fn sides_are_named_by_the_push() {
    let model = arm(0);
    let q = [-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657];
    let tool = model.forward_kinematics(&q).unwrap();
    for frame in [Frame::Base, Frame::Rotation([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])] {
        for law in [Law::Cap, Law::Impedance, Law::Paper] {
            for (axis, name) in NAMES.iter().enumerate() {
                for (yields, pushed) in [(CompliantSide::Plus, 1.0), (CompliantSide::Minus, -1.0)] {
                    let (soft, firm) = ([1.0, 2.0], [3.0, 4.0]);
                    let mut settings = Settings { law, task: Task { frame, ..Task::default() }, ..open() };
                    let given = Axis {
                        soft: Some(soft),
                        firm: Some(firm),
                        hold: Some(9.0),
                        yields: Some(yields),
                        ..Axis::default()
                    };
                    settings.set_axes(name, given).unwrap();
                    if law == Law::Impedance {
                        settings.axes[axis].stiffness = Some([50.0, 100.0]);
                        settings.accept_high_stiffness = true;
                    }
                    let mut controller = make(0, settings);
                    for (push, give) in [(pushed, true), (-pushed, false)] {
                        // A push toward + displaces the tool beyond its target along +.
                        let amount = push * 0.5;
                        let target = shifted(&tool, frame, axis, -amount);
                        let command = *controller.step(&q, &target, &StepInput::default()).unwrap();
                        let record = controller.diagnostics();
                        assert!((record.deviation[axis] + amount).abs() < 1e-9, "{name}: {:?}", record.deviation);
                        let strength = if give { firm[usize::from(push > 0.0)] } else { 9.0 };
                        assert!((record.softness[axis] - f64::from(u8::from(give))).abs() < 1e-15, "{name} {push}");
                        assert!((record.axis_strength[axis] - strength).abs() < 1e-12, "{name} {push}");
                        // The arm pulls back toward the target, against the push.
                        let rows = controller.task_jacobian();
                        let gravity = controller.diagnostics().gravity;
                        let kp = [150.0, 150.0, 150.0, 150.0, 60.0, 60.0, 60.0];
                        let lead = DVector::from_fn(7, |i, _| command.goal()[i] - q[i] - gravity[i] / kp[i]);
                        let back = (rows * lead)[axis];
                        assert!(back * push < 0.0, "{law:?} {name} pushed {push}: moves {back}");
                        if law != Law::Paper && give {
                            let factor = record.factors[1];
                            assert!(
                                (record.wrench[axis] + push * strength * factor).abs() < 1e-9,
                                "{name}: {:?}",
                                record.wrench
                            );
                        }
                    }
                }
            }
        }
    }
}

/// A spring pulls toward the target, a damper dissipates energy, and neither exceeds the cap, in any pose.
#[test]
fn springs_pull_to_the_target_and_dampers_dissipate() {
    let model = arm(0);
    let mut random = Random::new(12);
    let (mut derated, mut capped) = (0, 0);
    for round in 0..600 {
        let (stiffness, damping) = [(300.0, 0.0), (0.0, 40.0), (300.0, 40.0)][round % 3];
        let mut settings = Settings { law: Law::Impedance, gravity: false, rate: 50.0, ..open() };
        let spring = |scale: f64| Axis {
            stiffness: Some([scale * stiffness; 2]),
            damping: Some([scale * damping; 2]),
            hold: Some(scale * 10.0),
            ..Axis::default()
        };
        settings.set_axes("xyz", spring(1.0)).unwrap();
        settings.set_axes("rpy", spring(0.02)).unwrap();
        let mut controller = make(0, settings.clone());
        let q = random.joints(&model, 0.9);
        let size = random.pick(&[0.01, 0.3]);
        let target = random.target(&model, &q, size, size);
        let dq = random.vector(7, 0.5);
        controller.reset(&q).unwrap();
        controller.step(&q, &target, &StepInput { dq: Some(&dq), ..StepInput::default() }).unwrap();
        let record = controller.diagnostics();
        let v = controller.task_jacobian() * DVector::from_column_slice(&dq);
        for r in 0..6 {
            let force = record.wrench[r];
            if stiffness == 0.0 {
                assert!(force * v[r] <= 0.0, "a damper pushes: {force} {}", v[r]);
            } else if damping == 0.0 {
                assert!(force * record.deviation[r] >= 0.0, "a spring pushes away");
            }
            if !record.locked.contains(&true) {
                assert!(force.abs() <= record.axis_strength[r] * (1.0 + 1e-12));
            }
            capped += usize::from(force.abs() > 0.999 * record.axis_strength[r]);
        }
        // The effective stiffness does not exceed the bound, here that of the servos.
        let k = DVector::from_fn(6, |r, _| if r < 3 { stiffness } else { 0.02 * stiffness } * controller.gain_factor());
        let compliance = DMatrix::from_diagonal(&DVector::from_fn(7, |i, _| 1.0 / [150.0, 60.0][usize::from(i > 3)]));
        let root = DMatrix::from_diagonal(&k.map(f64::sqrt));
        let j = controller.task_jacobian();
        let rho = (&root * &j * compliance * j.transpose() * root).symmetric_eigenvalues().max();
        assert!(rho <= 3.0 * (1.0 + 1e-9), "{rho}");
        derated += usize::from(controller.gain_factor() < 1.0);
        // A measured delay takes effect at the next step.
        let relaxed = controller.gain_factor();
        controller.set_delay(0.1).unwrap();
        controller.reset(&q).unwrap();
        controller.step(&q, &target, &StepInput::default()).unwrap();
        assert!(controller.gain_factor() <= relaxed);
        derated += usize::from(controller.gain_factor() < 1.0);
    }
    assert!(derated > 100 && capped > 100, "{derated} {capped}");
}

/// Returns `pose` moved along, or rotated about, one axis of a frame by `amount` [m or rad].
fn shifted(pose: &Pose, frame: Frame, axis: usize, amount: f64) -> Pose {
    let columns = match frame {
        Frame::Rotation(r) => r,
        _ => Pose::IDENTITY.rotation,
    };
    let direction: [f64; 3] = std::array::from_fn(|i| columns[i][axis % 3] * amount);
    let mut out = *pose;
    if axis < 3 {
        (0..3).for_each(|i| out.position[i] += direction[i]);
    } else {
        let turn = Pose::from_rotation_vector([0.0; 3], direction).unwrap().rotation;
        for i in 0..3 {
            for j in 0..3 {
                out.rotation[i][j] = (0..3).map(|k| turn[i][k] * pose.rotation[k][j]).sum();
            }
        }
    }
    out
}

/// Returns the task Jacobian, computed from the model alone.
fn task_rows(model: &Model, settings: &Settings, q: &[f64]) -> DMatrix<f64> {
    let (pose, jacobian) = model.kinematics(q, pliant_core::Reference::WorldAligned).unwrap();
    let turn = match settings.task.frame {
        Frame::Base => Pose::IDENTITY.rotation,
        Frame::Tool => pose.rotation,
        Frame::Rotation(r) => r,
    };
    let axes: Vec<usize> = (0..6).filter(|&axis| settings.task.axes[axis]).collect();
    DMatrix::from_fn(axes.len(), model.n(), |r, i| {
        let (axis, block) = (axes[r] % 3, axes[r] / 3 * 3);
        (0..3).map(|c| turn[c][axis] * jacobian[(block + c, i)]).sum()
    })
}

#[test]
fn cost_gradients_are_derivatives() {
    let mut random = Random::new(6);
    for round in 0..60 {
        let index = round % 3;
        let model = arm(index);
        let axes =
            if index == 2 { ["xyz", "x z pitch"][round % 2] } else { ["all", "xyz", "y yaw", "x z pitch"][round % 4] };
        let frame = match round % 5 {
            0 | 1 => Frame::Base,
            2 | 3 => Frame::Tool,
            _ => Frame::Rotation(random.rotation()),
        };
        let rest = random.joints(&model, 0.5);
        let (weights, avoidance) = (random.vector(model.n(), 1.0).iter().map(|w| w.abs()).collect::<Vec<_>>(), 0.4);
        let settings = Settings {
            task: Task { frame, ..Task::parse(axes).unwrap() },
            tracking: Tracking { damping: Damping::Fixed(0.1), ..open().tracking },
            null_space: NullSpace { posture: Some(rest.clone()), limit_avoidance: avoidance, ..open().null_space },
            paper_options: PaperOptions {
                posture_weights: Some(weights.clone()),
                manipulability: 0.7,
                ..open().paper_options
            },
            ..open()
        };
        let cost = |q: &[f64]| {
            let j = task_rows(&model, &settings, q);
            let mut sum = -0.7 * 0.5 * (&j * j.transpose()).determinant().ln();
            for i in 0..q.len() {
                let (low, high) = (model.lower()[i], model.upper()[i]);
                sum += 0.5 * weights[i] * (q[i] - rest[i]).powi(2);
                sum += 0.5 * avoidance * ((q[i] - 0.5 * (low + high)) / (0.5 * (high - low))).powi(2);
            }
            vec![sum]
        };
        let q = random.joints(&model, 0.7);
        let sigma = task_rows(&model, &settings, &q).singular_values();
        if sigma.min() < 0.02 * sigma.max() {
            continue;
        }
        let mut controller = make(index, settings.clone());
        controller.step(&q, &model.forward_kinematics(&q).unwrap(), &StepInput::default()).unwrap();
        if controller.diagnostics().locked.contains(&true) {
            continue;
        }
        let want = common::finite_difference(cost, &q);
        for i in 0..q.len() {
            let (got, want) = (controller.diagnostics().gradient[i], want[0][i]);
            assert!((got - want).abs() < 1e-6 * want.abs().max(1.0), "{axes} {frame:?}, joint {i}: {got} {want}");
        }
    }
}

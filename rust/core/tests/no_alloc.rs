//! Control steps and the laws of an arm allocate no heap memory.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests and their helpers may panic")]
#![allow(unsafe_code, reason = "a counting allocator is an unsafe trait by nature")]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;

use pliant_core::arm::{
    CommandLimiter, DEFAULT_SPEED, HandGuidingOptions, JointFollowerOptions, LimiterInput, LoweringStart,
    PositionFilter, SwingResult, ThermalModel, ThermalOptions,
};
use pliant_core::kinematics::ArmPoints;
use pliant_core::params::{
    Axis, CompliantSide, Follow, Frame, Law, LimitRule, NullSpace, OnDeviationLimit, PaperOptions, Projector, Task,
    Tracking,
};
use pliant_core::{
    BatchCommand, BatchInput, BatchState, Controller, HandGuiding, JointFollower, Lowering, ModelOptions, Settings,
    StepInput, Targets,
};

#[path = "common/seeded.rs"]
mod seeded;

use seeded::Random;

/// Allocator that counts the calls by the current thread.
struct Counting;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

fn count_call() {
    // The access fails at the end of a thread, when its counter has been destroyed.
    let _ = COUNT.try_with(|count| count.set(count.get() + 1));
}

// SAFETY: every call is forwarded unchanged to the system's allocator; counting does not touch the allocated memory.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count_call();
        // SAFETY: the caller meets the requirements of `GlobalAlloc`, and `System` has no others.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count_call();
        // SAFETY: the caller meets the requirements of `GlobalAlloc`, and `System` has no others.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count_call();
        // SAFETY: the caller meets the requirements of `GlobalAlloc`, and `System` has no others.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count_call();
        // SAFETY: the caller meets the requirements of `GlobalAlloc`, and `System` has no others.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Returns the number of allocator calls, including frees, while `work` runs.
fn calls(work: impl FnOnce()) -> usize {
    let before = COUNT.get();
    work();
    COUNT.get() - before
}

#[test]
fn the_counter_counts() {
    assert_eq!(calls(|| drop(std::hint::black_box(vec![1_u8; 100]))), 2);
    assert_eq!(calls(|| drop(std::hint::black_box(vec![0_u8; 100]))), 2);
    let mut grown = Vec::with_capacity(1);
    assert_eq!(calls(|| (0..3).for_each(|i| grown.push(i))), 1);
    assert_eq!(calls(|| ()), 0);
}

/// Returns pairs of arm index and settings that together cover every branch of the step.
fn variants() -> Vec<(usize, Settings)> {
    let mut all = Vec::new();
    let axis = |yields| Axis { yields: Some(yields), ..Axis::default() };
    for law in [Law::Cap, Law::Impedance, Law::Paper] {
        for follow in [Follow::Free, Follow::Hold] {
            for projector in [Projector::Exact, Projector::Paper] {
                for (round, limits) in [LimitRule::Demand, LimitRule::Sum].into_iter().enumerate() {
                    let mut settings = Settings {
                        law,
                        delay: 0.01,
                        tracking: Tracking {
                            integrate: f64::from(u8::from(projector == Projector::Exact)),
                            ..Tracking::default()
                        },
                        null_space: NullSpace {
                            projector,
                            limit_avoidance: 0.1,
                            stiffness: (law == Law::Impedance && round == 1).then_some(2.0),
                            ..NullSpace::default()
                        },
                        paper_options: PaperOptions {
                            follow: (law != Law::Impedance).then_some(follow),
                            limits,
                            manipulability: 0.2 * round as f64,
                            budget_on_goal: law == Law::Paper && round == 1,
                            ..PaperOptions::default()
                        },
                        ..Settings::default()
                    };
                    settings.axes[1] = axis([CompliantSide::Both, CompliantSide::Plus][round]);
                    settings.axes[0].deviation_limit = Some(0.001);
                    settings.axes[0].on_deviation_limit = [OnDeviationLimit::Yield, OnDeviationLimit::Wait][round];
                    all.push((0, settings.clone()));
                    let task = Task { frame: Frame::Tool, ..Task::parse("xyz").unwrap() };
                    all.push((2, Settings { task, ..settings }));
                }
            }
        }
    }
    // More axes than joints, and no gravity model.
    let task = Task { length: Some(0.3), ..Task::default() };
    all.push((2, Settings { task, gravity: false, ..Settings::default() }));
    all
}

#[test]
fn ten_thousand_steps_do_not_allocate() {
    let (mut steps, mut locked) = (0, 0);
    for (index, settings) in variants() {
        let model = seeded::arm(index, &ModelOptions::default());
        let n = model.n();
        let mut random = Random::new(31);
        let mut controller = Controller::new(model.clone(), settings, Some(seeded::servos(index))).unwrap();
        for round in 0..400 {
            let q = random.joints(&model, 1.02);
            let target = random.target(&model, &q, 0.1, 0.5);
            let (dq, gradient, goal) = (random.vector(n, 1.0), random.vector(n, 1.0), random.joints(&model, 0.8));
            let twist = [0.1; 6];
            let input = StepInput {
                dt: Some(0.01),
                dq: (round % 2 == 0).then_some(&dq),
                twist: (round % 3 == 0).then_some(&twist),
                gradient: (round % 5 == 0).then_some(&gradient),
                posture: (round % 7 == 0).then_some(&goal),
            };
            let asked = calls(|| {
                for _ in 0..3 {
                    std::hint::black_box(controller.step(&q, &target, &input).is_ok());
                    std::hint::black_box(controller.step_joints(&q, &goal, &input).is_ok());
                }
                if round % 50 == 0 {
                    std::hint::black_box(controller.reset(&q).is_ok());
                }
            });
            assert_eq!(asked, 0, "{:?}", controller.settings());
            steps += 6;
            locked += usize::from(controller.diagnostics().locked.contains(&true));
        }
    }
    assert!(steps >= 10_000 && locked > 100, "{steps} {locked}");
}

#[test]
fn contact_estimation_does_not_allocate() {
    let model = std::sync::Arc::new(
        pliant_core::Model::from_urdf_str(
            include_str!("../robots/arm7.urdf"),
            &ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() },
        )
        .unwrap(),
    );
    let servos = pliant_core::Servos::new(vec![150.0; 7], vec![10.7; 7]);
    let mut controller = Controller::new(std::sync::Arc::clone(&model), Settings::default(), Some(servos)).unwrap();
    let mut contact = pliant_core::ContactEstimator::new(&controller, pliant_core::ContactOptions::default()).unwrap();
    let q = [-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17];
    let target = model.forward_kinematics(&q).unwrap();
    let input = pliant_core::ContactInput::default();
    let readings = [q, q].concat();
    let count = calls(|| {
        for _ in 0..20 {
            contact.update(&controller, &q, &input).unwrap();
            contact.update_series(&controller, &readings, &input).unwrap();
            controller.step(&q, &target, &StepInput::default()).unwrap();
        }
    });
    assert_eq!(count, 0);
    assert!(contact.estimate().uncertainty[2].is_finite());
}

/// Position filter, command limiter and thermal model.
#[test]
fn limits_of_commands_do_not_allocate() {
    let model = seeded::arm(0, &ModelOptions::default());
    let n = model.n();
    let servos = seeded::servos(0).for_joints(n).unwrap();
    let chain: Vec<usize> = (0..n).collect();
    let options =
        ThermalOptions { continuous: 0.4, time_constant: 30.0, supply: Some(1.0), shutdown_temperature: 70.0 };
    let mut thermal = ThermalModel::new(options, &servos.max_torque, Some(&vec![2.0; n])).unwrap();
    let mut limiter = CommandLimiter::new(&model, &servos, &chain, &servos.kp, &servos.max_torque).unwrap();
    let mut filter = PositionFilter::new(&vec![1.0; n]).unwrap();
    let (mut q, ok, ones) = (vec![0.2; n], vec![true; n], vec![1.0; n]);
    let count = calls(|| {
        for tick in 0..200 {
            q[0] = if tick % 50 == 0 { 3.0 } else { 0.2 };
            let time = [0.01 * f64::from(tick); pliant_core::MAX_JOINTS];
            filter.update(&q, &ok, &time[..n]);
            let input = LimiterInput {
                goal: model.upper(),
                torque_limit: &ones,
                gravity: &ones,
                position: filter.position(),
                off_chain: &[],
                ramp: 0.5,
                ramp_start: &ones,
                may_lead: tick % 2 == 0,
            };
            limiter.speeds(&ones).unwrap();
            limiter.limit(&thermal, &input).unwrap();
            limiter.update_heat(&mut thermal, [&q, &ones], &q, Some(&q), 0.01).unwrap();
        }
    });
    assert_eq!(count, 0);
}

/// Descent, hand guiding and thermal model, in all phases of a descent, with positions and without.
#[test]
fn laws_of_an_arm_do_not_allocate() {
    let model = seeded::arm(0, &ModelOptions::default());
    let n = model.n();
    let servos = seeded::servos(0).for_joints(n).unwrap();
    let points = Arc::new(ArmPoints::new(&model, &servos.armature).unwrap());
    let q = vec![0.2; n];
    let start = LoweringStart { q: &q, goal: None, torque_limit: None, rest_q: Some(&q), speed: DEFAULT_SPEED };
    let mut lowering = Lowering::new(Arc::clone(&model), &servos, points, &start).unwrap();
    let fresh = vec![true; n];
    let lost = vec![false; n];
    let mut position = q.clone();
    let count = calls(|| {
        for tick in 0..2000 {
            let ok = if (400..460).contains(&tick) { &lost } else { &fresh };
            let Some(command) = lowering.step(&position, ok, 0.01, 0.02).unwrap() else { break };
            for (q, goal) in position.iter_mut().zip(command.goal()) {
                *q += 0.3 * (goal - *q);
            }
        }
    });
    assert_eq!(count, 0, "descent");

    let zeros = vec![0.0; n];
    let swing = SwingResult { q: &q, goal: &q, swung: &fresh, lead: &zeros, friction: &zeros };
    let options = HandGuidingOptions {
        stiffness_error: 2.0,
        delay: 0.01,
        torque_share: 0.3,
        payload_moments: [0.1, 0.0, 0.0, 0.01],
    };
    let mut guiding = HandGuiding::new(Arc::clone(&model), &servos, &zeros, &swing, options).unwrap();
    let count = calls(|| {
        for tick in 0..200 {
            position[0] = 0.2 + 0.002 * f64::from(tick.min(100));
            guiding.step(&position, 0.01).unwrap();
        }
    });
    assert_eq!(count, 0, "hand guiding");

    let options = JointFollowerOptions { max_force: [4.0; 3], max_tool_speed: 0.6, max_joint_speed: 4.0 };
    let mut follower = JointFollower::new(model, &servos, options).unwrap();
    let count = calls(|| {
        for tick in 0..200 {
            position[0] = 0.2 + 0.002 * f64::from(tick.min(100));
            follower.step(&position, &q, 0.01).unwrap();
        }
    });
    assert_eq!(count, 0, "joint follower");
}

#[test]
fn a_batch_row_with_caps_does_not_allocate() {
    let mut settings = Settings::default();
    settings.axes[1] = Axis { soft: Some([4.0; 2]), ..Axis::default() };
    let model = seeded::arm(0, &ModelOptions::default());
    let controller = Controller::new(model.clone(), settings, Some(seeded::servos(0))).unwrap();
    let target = model.forward_kinematics(&[0.1; 7]).unwrap();
    let of = |count: usize| {
        let (q, mut state) = ([0.1; 7].repeat(count), BatchState::new(7, count).unwrap());
        let caps = [f64::NAN, 2.0, f64::NAN, f64::NAN, f64::NAN, f64::NAN].repeat(count);
        let adaptation = [f64::NAN, 0.5, f64::NAN, f64::NAN, f64::NAN, f64::NAN].repeat(count);
        let mut out = [q.clone(), q.clone(), q.clone()];
        let input = BatchInput {
            caps: Some(&caps),
            adaptation: Some(&adaptation),
            ..BatchInput::new(&q, Targets::One(&target))
        };
        let mut step = || {
            let [goal, torque_limit, velocity] = &mut out;
            let out = BatchCommand { goal, torque_limit, velocity };
            controller.step_batch(&input, Some(&mut state), out).unwrap();
        };
        step();
        calls(step)
    };
    assert_eq!(of(1), of(64)); // The number of allocations does not depend on the number of rows.
}

//! Options of a model (base, tip, locked joints, limits) and properties of the model (mimics, masses).

use std::collections::BTreeMap;
use std::fmt::Write as _;

use pliant_core::error::Error;
use pliant_core::model::{JointKind, Model, ModelOptions, Payload};

use crate::common::{self, arm7, between, close, data, robot};

fn load(name: &str, options: &ModelOptions) -> Result<Model, Error> {
    Model::from_urdf_file(data("robots").join(name).with_extension("urdf"), options)
}

fn message(name: &str, options: &ModelOptions) -> String {
    load(name, options).unwrap_err().to_string()
}

fn locked(name: &str, value: f64) -> ModelOptions {
    ModelOptions { locked: BTreeMap::from([(name.into(), value)]), ..between("base", "tool") }
}

fn limited(name: &str, lower: f64, upper: f64) -> ModelOptions {
    ModelOptions { limits: BTreeMap::from([(name.into(), (lower, upper))]), ..between("base", "tool") }
}

#[test]
fn arm7_agrees_with_its_file() {
    let model = arm7();
    assert_eq!((model.name(), model.n(), model.base(), model.tip()), ("arm7", 7, "base", "tool"));
    assert_eq!(model.joint_names()[..2], ["shoulder_pitch", "shoulder_roll"]);
    close("lower", model.lower()[0], -3.0, 0.0);
    close("upper", model.upper()[6], 1.8, 0.0);
    assert_eq!(model.effort_limit()[3..5], [Some(10.7), Some(6.4)]);
    assert_eq!(model.velocity_limit()[0], Some(6.0));
    assert_eq!(model.prismatic(), [false; 7]);
    assert!(model.unknown_mass_joints().is_empty());
    assert_eq!(model.frames().len(), 9);
    close("reach", model.reach(), 0.71, 1e-15);
    let elbow = &model.joints()[3];
    assert_eq!(
        (elbow.name.as_str(), elbow.kind, elbow.q_index, elbow.locked_at),
        ("elbow_pitch", JointKind::Revolute, Some(3), None)
    );
    assert_eq!((elbow.damping, elbow.friction), (Some(1.2), Some(0.2)));
    let tool = model.joints().last().unwrap();
    assert_eq!((tool.kind, tool.damping, tool.q_index), (JointKind::Fixed, None, None));
    assert_eq!(model.links()[8].inertial, None);
    close("mass", model.links()[7].inertial.unwrap().mass, 0.5, 0.0);
}

#[test]
fn the_default_tip_must_be_unique() {
    assert_eq!(load("planar_2r", &ModelOptions::default()).unwrap().tip(), "tool");
    let two = message("hobby_5dof", &ModelOptions::default());
    assert!(two.starts_with("tip: this robot branches and ends in 2 links: finger, tool; say which frame is the tool, of: base, shoulder"), "{two}");
}

#[test]
fn unknown_frames_are_listed_with_similar_names() {
    let error = load("hobby_5dof", &between("base", "tol")).unwrap_err();
    let Error::FrameNotFound { frame, available } = &error else { panic!("{error}") };
    assert_eq!((frame.as_str(), available[0].as_str(), available.len()), ("tol", "tool", 8));
    assert!(error.to_string().starts_with("frame 'tol' not found; frames of this robot: tool, "));
    assert!(matches!(load("hobby_5dof", &between("bass", "tool")).unwrap_err(), Error::FrameNotFound { .. }));
}

#[test]
fn the_base_may_be_any_link_fixed_to_the_start_of_the_chain() {
    let from_root = load("fixed_pairs", &between("base", "tool")).unwrap();
    let from_mount = load("fixed_pairs", &between("a2", "tool")).unwrap();
    let q = [0.3, -0.4];
    let mount = common::link_poses(&from_root, &q)[from_root.frames().iter().position(|f| *f == "a2").unwrap()];
    let off = mount * common::isometry(&from_mount.forward_kinematics(&q).unwrap());
    let want = common::isometry(&from_root.forward_kinematics(&q).unwrap());
    assert!((off.to_homogeneous() - want.to_homogeneous()).amax() < 1e-15);

    // A fixed link beside the chain, as on many industrial arms, and a base in the middle of the chain.
    let text = std::fs::read_to_string(data("robots/planar_2r.urdf")).unwrap();
    let mounted = text.replace(
        "</robot>",
        "<link name=\"mount\"/><joint name=\"m\" type=\"fixed\"><parent link=\"base\"/><child link=\"mount\"/><origin xyz=\"1 0 0\"/></joint></robot>",
    );
    let model = Model::from_urdf_str(&mounted, &between("mount", "tool")).unwrap();
    close("x", model.forward_kinematics(&[0.0, 0.0]).unwrap().position[0], 0.8 - 1.0, 1e-15);
    assert_eq!(load("planar_2r", &between("upper", "tool")).unwrap().joint_names(), ["elbow"]);

    let moving = message("hobby_5dof", &between("finger", "tool"));
    assert!(moving.contains("no joint between base and tip can move"), "{moving}");
    let across = message("mimics", &between("w", "tool"));
    assert!(
        across
            .contains("base: 'w' is not rigidly fixed to 'l2', where the chain to 'tool' starts: joint 'weight' moves"),
        "{across}"
    );
    let same = message("planar_2r", &between("tool", "tool"));
    assert!(same.starts_with("tip: no joint between base and tip can move; choose another base or tip"), "{same}");
}

#[test]
fn joints_beside_the_chain_are_locked() {
    let rests = robot("hobby_5dof");
    let jaw = rests.joints().iter().find(|j| j.name == "jaw").unwrap();
    assert_eq!((jaw.q_index, jaw.locked_at), (None, Some(0.2)), "0 is outside, the nearest limit is taken");
    let open = load("hobby_5dof", &locked("jaw", 1.5)).unwrap();
    let q = common::state(&open, 3);
    let energy = common::finite_difference(|q| vec![common::potential_energy(&open, q)], &q);
    for k in 0..5 {
        close("gravity", open.gravity(&q).unwrap()[k], energy[0][k], 1e-8);
    }
    assert!((open.gravity(&q).unwrap() - rests.gravity(&q).unwrap()).amax() > 1e-4, "the jaw's mass has moved");

    let text = message("hobby_5dof", &locked("jaw", 0.0));
    assert_eq!(text, "locked.jaw = 0 is outside [0.2, 1.6], the limits of this joint");
    assert!(message("hobby_5dof", &locked("jaw", f64::NAN)).starts_with("locked.jaw = NaN is outside"));
    let text = message("hobby_5dof", &locked("jow", 1.0));
    assert!(text.starts_with("locked.jow: no joint of that name; joints: jaw, "), "{text}");
    assert_eq!(message("hobby_5dof", &locked("grasp", 0.0)), "locked.grasp: a joint of type 'fixed' cannot be locked");
    let text = message("mimics", &locked("half", 0.0));
    assert_eq!(text, "locked.half: follows 'lead' (mimic); lock 'lead' instead");
}

#[test]
fn a_joint_of_the_chain_can_be_locked_too() {
    let whole = robot("twisted_6r");
    let short = load("twisted_6r", &locked("j3", 0.7)).unwrap();
    assert_eq!(short.joint_names(), ["j1", "j2", "j4", "j5", "j6"]);
    let (a, b) =
        (whole.gravity(&[0.1, 0.2, 0.7, 0.4, 0.5, 0.6]).unwrap(), short.gravity(&[0.1, 0.2, 0.4, 0.5, 0.6]).unwrap());
    for (k, i) in [0, 1, 3, 4, 5].into_iter().enumerate() {
        close("gravity", b[k], a[i], 1e-14);
    }
    let followers = load("mimics", &locked("lead", 1.0)).unwrap();
    assert_eq!(followers.joint_names(), ["final"]);
    let quarter = followers.joints().iter().find(|j| j.name == "quarter").unwrap();
    close("follower of a locked joint", quarter.locked_at.unwrap(), 0.5 * (-0.5 + 0.3), 1e-15);
}

#[test]
fn limits_can_replace_those_of_the_file() {
    let text = std::fs::read_to_string(data("guards/01_no_limit.urdf")).unwrap();
    let options = ModelOptions { limits: BTreeMap::from([("j".into(), (-0.5, 1.5))]), ..ModelOptions::default() };
    let model = Model::from_urdf_str(&text, &options).unwrap();
    assert_eq!((model.lower(), model.upper()), (&[-0.5][..], &[1.5][..]));
    let pan = load("hobby_5dof", &limited("pan", -2.0, 2.0)).unwrap();
    assert_eq!((pan.lower()[0], pan.upper()[0]), (-2.0, 2.0));
    let free = robot("hobby_5dof");
    assert_eq!((free.lower()[0], free.upper()[0]), (f64::NEG_INFINITY, f64::INFINITY));

    for (lower, upper) in [(1.0, 1.0), (1.0, -1.0), (f64::NAN, 1.0), (f64::NEG_INFINITY, 1.0), (-1e7, 1.0)] {
        let text = message("hobby_5dof", &limited("lift", lower, upper));
        assert!(text.contains("must be finite, within ±1e6, the lower one first"), "{text}");
    }
    assert!(
        message("hobby_5dof", &limited("lifd", 0.0, 1.0))
            .starts_with("limits.lifd: no joint of that name; joints: lift, ")
    );
    assert!(message("hobby_5dof", &limited("grasp", 0.0, 1.0)).contains("a joint of type 'fixed' has no limits"));
}

#[test]
fn mimic_joints_share_the_column_of_their_driver() {
    let model = robot("mimics");
    assert_eq!(model.joint_names(), ["lead", "final"]);
    let quarter = model.joints().iter().find(|j| j.name == "quarter").unwrap();
    let mimic = quarter.mimic.unwrap();
    assert_eq!(model.joints()[mimic.joint].name, "lead", "a follower's follower follows the leader");
    close("multiplier", mimic.multiplier, 0.5 * -0.5, 0.0);
    close("offset", mimic.offset, 0.5 * 0.3, 0.0);
    assert_eq!(quarter.q_index, Some(0));
    let counter = model.joints().iter().find(|j| j.name == "counter").unwrap();
    assert_eq!(counter.q_index, Some(0), "beside the chain, but moved by it");
    let other = model.joints().iter().find(|j| j.name == "other").unwrap();
    assert_eq!((other.q_index, other.locked_at), (None, Some(-0.01)));
}

#[test]
fn missing_masses_differ_from_massless_links() {
    let text = std::fs::read_to_string(data("robots/planar_2r.urdf")).unwrap();
    let start = text.rfind("<inertial>").unwrap();
    let end = text.rfind("</inertial>").unwrap() + "</inertial>".len();
    let without = format!("{}{}", &text[..start], &text[end..]);
    let model = Model::from_urdf_str(&without, &ModelOptions::default()).unwrap();
    assert_eq!(model.unknown_mass_joints(), [1]);
    let with_payload = ModelOptions { payload: Some(Payload { mass: 0.2, com: [0.0; 3] }), ..ModelOptions::default() };
    assert!(Model::from_urdf_str(&without, &with_payload).unwrap().unknown_mass_joints().is_empty());
    assert!(robot("fixed_pairs").unknown_mass_joints().is_empty(), "two of its links have no inertial");
}

#[test]
fn too_many_joints_are_rejected_with_their_number() {
    let chain = |joints: usize| {
        let mut text = String::from("<robot name=\"r\"><link name=\"l0\"/>");
        for i in 1..=joints {
            let _ = write!(
                text,
                "<link name=\"l{i}\"/><joint name=\"j{i}\" type=\"continuous\"><parent link=\"l{}\"/><child link=\"l{i}\"/></joint>",
                i - 1
            );
        }
        text + "</robot>"
    };
    assert_eq!(Model::from_urdf_str(&chain(16), &ModelOptions::default()).unwrap().n(), 16);
    let error = Model::from_urdf_str(&chain(17), &ModelOptions::default()).unwrap_err().to_string();
    assert!(error.starts_with("tip: 17 moving joints between base and tip, at most 16; lock some"), "{error}");
    let long = chain(16).replace("</robot>", "<link name=\"x\"/><joint name=\"x\" type=\"continuous\"><parent link=\"l3\"/><child link=\"x\"/><mimic joint=\"j2\"/></joint></robot>");
    let error = Model::from_urdf_str(&long, &between("l0", "l16")).unwrap_err().to_string();
    assert!(
        error.contains("more than 16 moving joints: those that follow a joint of the chain by mimic count too")
            && error.contains("'j2'"),
        "{error}"
    );
}

#[test]
fn options_are_checked() {
    let gravity = ModelOptions { gravity: [0.0, f64::NAN, 0.0], ..ModelOptions::default() };
    assert_eq!(message("planar_2r", &gravity), "gravity.y [m/s²] = NaN is outside ±1e6");
    let payload =
        |mass: f64, com: [f64; 3]| ModelOptions { payload: Some(Payload { mass, com }), ..ModelOptions::default() };
    assert_eq!(message("planar_2r", &payload(-1.0, [0.0; 3])), "payload.mass [kg] = -1 is outside 0 to 1e6");
    assert!(
        message("planar_2r", &payload(1.0, [0.0, 0.0, f64::INFINITY]))
            .starts_with("payload.com.z [m] = inf is outside")
    );
}

#[test]
fn quaternions_are_not_converted_to_angles() {
    // A pitch within 0.2° of 90°, where a conversion to roll, pitch and yaw would be inaccurate.
    let half: f64 = (std::f64::consts::FRAC_PI_2 - 0.003) / 2.0;
    let text = std::fs::read_to_string(data("guards/14_quat_in_1_0.urdf")).unwrap();
    let text = text
        .replace("name=\"r\"", "name=\"r\" version=\"1.1\"")
        .replace("0 0 0.6 0.8", &format!("0 {} 0 {}", half.sin(), half.cos()));
    let model = Model::from_urdf_str(&text, &ModelOptions::default()).unwrap();
    let pose = model.forward_kinematics(&[0.0]).unwrap();
    close("R[2][2]", pose.rotation[2][2], 0.003_f64.sin(), 1e-15);
}

#[test]
fn unused_elements_cannot_make_a_file_invalid() {
    // A valid file with unknown elements, invalid visuals, comments, a byte-order mark, a default namespace and CRLF
    // line ends, but no XML declaration.
    let text = "\u{feff}<!-- made by hand --><robot name=\"r &amp; s\" version=\"1.2\">\r\n<material/><gazebo><a/></gazebo><?go now?>\
        <link name=\"a b\"><visual><geometry/></visual><collision/>words<!-- note --></link>\r\n<link name=\"ü/1\"/>\
        <joint name=\"j\" type=\"revolute\"><parent link=\"a b\"/><child link=\"ü/1\"/><origin/><safety_controller/>\
        <limit lower=\" -1 \" upper=\"+1e0\"\n/><dynamics/><calibration rising=\"x\"/></joint></robot><!-- end -->";
    let model = Model::from_urdf_str(text, &ModelOptions::default()).unwrap();
    assert_eq!((model.name(), model.tip(), model.upper()), ("r & s", "ü/1", &[1.0][..]));
    let spaced = text.replace("version=\"1.2\"", "xmlns=\"http://example.org/urdf\"");
    assert_eq!(Model::from_urdf_str(&spaced, &ModelOptions::default()).unwrap().n(), 1);
}

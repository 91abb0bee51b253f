//! Every check of the URDF reader rejects its file with a message that names the element, its value and the remedy.

use pliant_core::error::Error;
use pliant_core::model::{Model, ModelOptions};

use crate::common::data;

/// Asserts that a file of `data/guards` is rejected with a message that contains all `pieces`.
#[track_caller]
fn assert_rejected(file: &str, pieces: &[&str]) {
    let path = data("guards").join(file).with_extension("urdf");
    let error = Model::from_urdf_file(&path, &ModelOptions::default()).expect_err(file);
    let message = error.to_string();
    for piece in pieces {
        assert!(message.contains(piece), "{file}\n  got:     {message}\n  missing: {piece}");
    }
    if let Error::Urdf { source_name, .. } = &error {
        assert!(source_name.ends_with(&format!("{file}.urdf")), "{source_name}");
    }
}

#[track_caller]
fn read(file: &str) -> Model {
    let path = data("guards").join(file).with_extension("urdf");
    Model::from_urdf_file(&path, &ModelOptions::default()).unwrap()
}

#[test]
fn guard_01_position_limits_exist_and_are_ordered() {
    let remedy = "pass limits = {\"j\": (lower, upper)}";
    assert_rejected(
        "01_no_limit",
        &["joint 'j' (revolute) has no lower and upper position limits", remedy, ".urdf:4:3: "],
    );
    assert_rejected("01_no_lower", &["joint 'j' (revolute) has no lower position limit", remedy]);
    assert_rejected(
        "01_no_range_version_1_2",
        &["joint 'j' (revolute) has no lower and upper position limits", remedy],
    );
    assert_rejected("01_limits_reversed", &["joint 'j': lower limit 1 is above upper limit -1"]);
    assert_rejected("01_limits_equal", &["joint 'j' (revolute) has lower = upper = 0 and cannot move", remedy]);
    assert_rejected(
        "01_limits_nan",
        &["joint 'j': lower of <limit> is \"nan\"", "'nan' is not a finite number", ":7:5: "],
    );
}

#[test]
fn guard_02_an_empty_effort_counts_as_absent() {
    assert_eq!(read("02_effort_absent").effort_limit(), [None, None, None]);
    assert_rejected("02_effort_nan", &["joint 'j': effort of <limit> is \"nan\""]);
}

#[test]
fn guard_03_an_empty_velocity_counts_as_absent() {
    assert_eq!(read("03_velocity_absent").velocity_limit(), [None, None]);
    assert_rejected(
        "03_velocity_not_a_number",
        &["joint 'j': velocity of <limit> is \"fast\"", "expected 1 finite number"],
    );
}

#[test]
fn guard_04_mimics_refer_to_a_moving_joint() {
    assert_rejected(
        "04_mimic_itself",
        &["joint 'k' is in a ring of mimics that leads back to 'k'; one joint must lead"],
    );
    assert_rejected("04_mimic_ring", &["joint 'j' is in a ring of mimics that leads back to", "one joint must lead"]);
    assert_rejected("04_mimic_unknown", &["joint 'k' mimics 'J', which does not exist; joints: j, k"]);
    assert_rejected(
        "04_mimic_fixed_on_chain",
        &["joint 'k' mimics 'j', which is of type 'fixed' and never moves", "locked = {\"k\": value}"],
    );
    assert_rejected("04_mimic_zero", &["joint 'k' mimics 'j' with multiplier 0; make the joint fixed"]);
    let bound = "each must be at most 1000000";
    assert_rejected("04_mimic_multiplier", &["joint 'k' mimics 'j' with multiplier 1e300 and offset 0.0", bound]);
    assert_rejected("04_mimic_offset", &["joint 'k' mimics 'j' with multiplier 1.0 and offset 1e300", bound]);
    assert_rejected("04_mimic_chain", &["joint 'l' mimics 'j' with multiplier 100000000.0 and offset 0.0", bound]);
}

#[test]
fn guard_05_axes_are_not_zero() {
    assert_rejected("05_axis_zero", &["joint 'j': axis [0.0, 0.0, 0.0] has length 0", "e.g. \"0 0 1\"", ":6:5: "]);
    assert_rejected("05_axis_nan", &["joint 'j': xyz of <axis> is \"0 nan 1\"; 'nan' is not a finite number"]);
}

#[test]
fn guard_06_numbers_are_finite_and_complete() {
    assert_rejected(
        "06_four_tokens",
        &["xyz of <origin> is \"abc 1 2 3\"; 'abc' is not a finite number; expected 3 finite numbers, got 4"],
    );
    assert_rejected("06_expression", &["xyz of <origin> is \"${x} 0 0 1\"", "xacro robot.urdf.xacro > robot.urdf"]);
    assert_rejected("06_two_tokens", &["rpy of <origin> is \"0 1\"; expected 3 finite numbers, got 2 words"]);
    assert_rejected("06_infinite", &["xyz of <origin> is \"0 inf 0\"; 'inf' is not a finite number"]);
    assert_rejected("06_negative_mass", &["link 'arm': mass is -1 kg; it must be between 0 and 1e6"]);
    assert_rejected("06_negative_inertia", &["link 'arm': ixx is -1 kg·m²; it must not be negative"]);
    assert_rejected("06_nan_inertia", &["link 'arm': iyz of <inertia> is \"nan\""]);
}

#[test]
fn guard_07_names_exist_and_are_unique() {
    assert_rejected("07_link_twice", &["two links are named 'arm', first in line 3; names must be unique", ":4:3: "]);
    assert_rejected("07_joint_twice", &["two joints are named 'j', first in line 5"]);
    assert_rejected("07_link_unnamed", &["a link without a name; give it name=\"...\"", ":3:3: "]);
    assert_rejected("07_joint_unnamed", &["a joint without a name"]);
}

#[test]
fn guard_08_links_form_one_tree() {
    assert_rejected("08_two_roots", &["2 links have no parent joint (base, b); a robot has one root"]);
    assert_rejected("08_two_parents", &["link 'c' has two parents: joint 'l' and joint 'm'; a robot must be a tree"]);
    assert_rejected("08_loop", &["every link has a parent joint, so the joints form a loop"]);
    assert_rejected("08_loop_beside_root", &["link 'a' is not connected to the root 'base': its parents form a loop"]);
    assert_rejected("08_own_parent", &["joint 'j': link 'arm' is its own parent"]);
    assert_rejected("08_unknown_link", &["joint 'j': child link 'arn' does not exist; links: arm, base", ":4:3: "]);
    assert_rejected("08_no_parent", &["joint 'j': <parent link=\"...\"/> is missing"]);
}

#[test]
fn guard_09_the_text_is_an_expanded_robot_that_moves() {
    let remedy = "expand the file first: xacro robot.urdf.xacro > robot.urdf";
    assert_rejected(
        "09_xacro_element",
        &["the element <xacro:property> shows that xacro was not run", remedy, ":2:3: "],
    );
    assert_rejected("09_xacro_undeclared", &["xacro was not run", remedy, ":2:"]);
    assert_rejected("09_xacro_name", &["the name '${prefix}base' shows that xacro was not run", remedy]);
    assert_rejected(
        "09_mjcf",
        &["the root element is <mujoco>, not <robot>: this is an MJCF model of MuJoCo", ":1:1: "],
    );
    assert_rejected("09_sdf", &["the root element is <sdf>, not <robot>: this looks like SDF (Gazebo)", ":2:1: "]);
    assert_rejected("09_no_links", &["the robot has no links"]);
    assert_rejected("09_nothing_moves", &["no joint between base and tip can move", "frames: base, arm"]);
}

#[test]
fn guard_10_xacro_is_not_run_for_a_file_extension() {
    // The reader must ignore the extension, with which other readers run the program `xacro`.
    let path = std::env::temp_dir().join(format!("pliant-guard-{}.xacro", std::process::id()));
    std::fs::copy(data("guards/03_velocity_absent.urdf"), &path).unwrap();
    let model = Model::from_urdf_file(&path, &ModelOptions::default());
    std::fs::remove_file(&path).unwrap();
    assert_eq!(model.unwrap().n(), 2);
    let error = Model::from_urdf_file("no/such/file.xacro", &ModelOptions::default()).unwrap_err().to_string();
    assert!(error.starts_with("no/such/file.xacro: cannot be read: "), "{error}");
}

#[test]
fn guard_11_joints_without_one_degree_of_freedom() {
    assert_rejected(
        "11_floating_on_chain",
        &["joint 'float' is of type 'floating', which has no single coordinate", "choose a base below it"],
    );
    assert_rejected(
        "11_unknown_type",
        &["joint 'j': type is 'screw'; it must be one of revolute, continuous, prismatic, fixed"],
    );
}

#[test]
fn guard_12_inertials_are_complete() {
    assert_rejected(
        "12_no_inertia",
        &["link 'arm': <inertial> without <inertia ixx=", "leave <inertial> out for a massless link", ":4:5: "],
    );
    assert_rejected("12_no_mass", &["link 'arm': <inertial> without <mass value=\"...\"/>"]);
}

#[test]
fn guard_13_hostile_xml() {
    assert_rejected("13_entities", &["a DOCTYPE is refused", "remove it", ":2:1: "]);
    assert_rejected("13_unknown_entity", &["unknown entity '&b;'", ":1:"]);
    assert_rejected("13_truncated", &["the text ends too early; </robot> is missing"]);
    assert_rejected("13_crossed", &["not well-formed XML", ":2:"]);
}

#[test]
fn guard_14_quaternions() {
    let old = "joint 'j': quat_xyzw needs <robot version=\"1.1\"> or later";
    assert_rejected("14_quat_in_1_0", &[old, "use rpy"]);
    assert_rejected("14_quat_in_1", &[old]);
    assert_rejected("14_quat_norm", &["joint 'j': quat_xyzw has norm 2; it must be 1 within 1e-3"]);
    assert_rejected("14_quat_three", &["quat_xyzw of <origin> is \"0 0 1\"; expected 4 finite numbers, got 3 words"]);
    assert_rejected("14_quat_and_rpy", &["joint 'j': <origin> has both rpy and quat_xyzw; keep one"]);
}

#[test]
fn size_depth_and_count_are_bounded() {
    let load = |text: &str| Model::from_urdf_str(text, &ModelOptions::default()).unwrap_err().to_string();
    assert_eq!(load(""), "<string>: the text is empty; a URDF starts with <robot name=\"...\">");
    let deep = format!("<robot name=\"r\">{}{}</robot>", "<a>".repeat(200_000), "</a>".repeat(200_000));
    assert!(load(&deep).contains("elements nested deeper than 64 levels"));
    let unclosed = format!("<robot name=\"r\">{}", "<a>".repeat(1_000_000));
    assert!(load(&unclosed).contains("</robot> is missing"));
    let long = format!("<robot name=\"r\"><link name=\"a\"/><!--{}--></robot>", " ".repeat(16 << 20));
    assert!(load(&long).contains("bytes of text, at most 16777216"));
    let links = "<link name=\"x\"/>".repeat(100_000);
    assert!(load(&format!("<robot name=\"r\">{links}</robot>")).contains("more than 10000 links"));
}

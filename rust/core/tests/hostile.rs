//! Arbitrary text gives a model or an error, never a panic or an endless loop.

use std::time::Instant;

use pliant_core::model::{Model, ModelOptions};
use proptest::prelude::*;

use crate::common::root;

/// Reads the text; if that succeeds, also computes kinematics with the model.
fn read_and_use(text: &str) {
    if let Ok(model) = Model::from_urdf_str(text, &ModelOptions::default()) {
        let q = vec![0.3; model.n()];
        model.gravity(&q).unwrap();
        model.forward_kinematics(&q).unwrap();
    }
}

/// Xorshift generator with a fixed seed, so that the mutations are the same in every run.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        usize::try_from(self.0 >> 16).unwrap() % bound.max(1)
    }
}

const PIECES: [&str; 24] = [
    "<",
    ">",
    "/",
    "\"",
    "&",
    "&lt;",
    "nan",
    "-inf",
    "1e999",
    "0",
    "<link name=\"x\"/>",
    "<joint>",
    "</joint>",
    "<!--",
    "-->",
    "<![CDATA[",
    "mimic",
    "<mimic joint=\"elbow_pitch\"/>",
    "fixed",
    "floating",
    "${x}",
    "\u{0}",
    "ß",
    "type=\"prismatic\"",
];

#[test]
fn ten_thousand_mutations_of_a_robot() {
    let original = std::fs::read_to_string(root().join("tests/data/golden/arm7.urdf")).unwrap();
    let start = original.find("<robot").unwrap();
    let original: Vec<char> = original[start..].chars().collect();
    let mut dice = Random(0x9E37_79B9_7F4A_7C15);
    let mut accepted = 0;
    for _ in 0..10_000 {
        let mut text = original.clone();
        for _ in 0..=dice.below(4) {
            let (at, length) = (dice.below(text.len()), dice.below(40));
            let end = (at + length).min(text.len());
            match dice.below(5) {
                0 => drop(text.drain(at..end)),
                1 => drop(text.splice(at..at, PIECES[dice.below(PIECES.len())].chars())),
                2 => drop(text.splice(at..end.min(at + 1), PIECES[dice.below(PIECES.len())].chars())),
                3 => {
                    let copy: Vec<char> = text[at..end].to_vec();
                    let to = dice.below(text.len());
                    drop(text.splice(to..to, copy));
                }
                _ => {
                    let other = dice.below(text.len());
                    text.swap(at, other);
                }
            }
        }
        let text: String = text.into_iter().collect();
        accepted += usize::from(Model::from_urdf_str(&text, &ModelOptions::default()).is_ok());
        read_and_use(&text);
    }
    println!("{accepted} of 10000 mutants still load");
    assert!(accepted > 100 && accepted < 9_900);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3000))]

    #[test]
    fn any_string(text in any::<String>()) {
        read_and_use(&text);
    }

    #[test]
    fn any_attributes(name in any::<String>(), numbers in "[-+0-9.eEinfa \t\n]{0,30}", kind in "[a-z]{0,12}", attribute in "[a-z_:]{1,8}") {
        read_and_use(&format!(
            "<robot name=\"{name}\"><link name=\"{name}\"><inertial><mass value=\"{numbers}\"/><inertia ixx=\"{numbers}\"/></inertial>\
             </link><link name=\"b\" {attribute}=\"{numbers}\"/><joint name=\"j\" type=\"{kind}\"><parent link=\"{name}\"/>\
             <child link=\"b\"/><origin xyz=\"{numbers}\" rpy=\"{numbers}\"/><axis xyz=\"{numbers}\"/><limit lower=\"{numbers}\" \
             upper=\"{numbers}\"/></joint></robot>"
        ));
    }

    #[test]
    fn any_numbers(x in any::<f64>(), y in any::<f64>(), z in any::<f64>()) {
        read_and_use(&format!(
            "<robot name=\"r\"><link name=\"a\"/><link name=\"b\"><inertial><origin xyz=\"{x} {y} {z}\" rpy=\"{z} {x} {y}\"/><mass value=\"{x}\"/>\
             <inertia ixx=\"{x}\" ixy=\"0\" ixz=\"0\" iyy=\"{y}\" iyz=\"0\" izz=\"{z}\"/></inertial></link><joint name=\"j\" \
             type=\"prismatic\"><parent link=\"a\"/><child link=\"b\"/><origin xyz=\"{y} {z} {x}\" rpy=\"{x} {y} {z}\"/><axis xyz=\"{z} {y} {x}\"/>\
             <limit lower=\"{x}\" upper=\"{y}\" effort=\"{z}\" velocity=\"{x}\"/></joint></robot>"
        ));
    }
}

/// The time limits are far above the measured time of one second: they detect a hang, but do not fail on a slow
/// machine.
#[test]
fn large_texts_are_read_in_bounded_time() {
    let slots = |count: usize, one: &dyn Fn(usize) -> String| (0..count).map(one).collect::<String>();
    let link = |i: usize| format!("<link name=\"l{i}\"/>");
    let joint = |i: usize, kind: &str, more: &str| {
        let parent = i.saturating_sub(1);
        format!("<joint name=\"j{i}\" type=\"{kind}\"><parent link=\"l{parent}\"/><child link=\"l{i}\"/>{more}</joint>")
    };
    let robot = |inside: String| format!("<robot name=\"r\">{inside}</robot>");
    let cases: [(&str, String); 9] = [
        ("10⁵ links", robot(slots(100_000, &link) + &slots(99_999, &|i| joint(i + 1, "fixed", "")))),
        (
            "10⁴ links in a row",
            robot(
                slots(10_000, &link)
                    + &slots(9_999, &|i| joint(i + 1, if i == 5_000 { "continuous" } else { "fixed" }, "")),
            ),
        ),
        (
            "10⁴ followers in a row",
            robot(
                slots(10_000, &link)
                    + &slots(9_999, &|i| {
                        let mimic = format!("<mimic joint=\"j{}\"/>", i + 2);
                        joint(i + 1, "revolute", if i < 9_998 { &mimic } else { "" })
                    }),
            ),
        ),
        ("10⁶ elements", robot("<link name=\"a\"/>".to_owned() + &"<x/>".repeat(1_000_000))),
        ("10⁶ attributes", format!("<robot name=\"r\"{}/>", slots(1_000_000, &|i| format!(" a{i}=\"\"")))),
        (
            "15 MB of name spaces",
            robot(slots(5_000, &|i| format!("<x{}/>", slots(60, &|j| format!(" xmlns:a{j}=\"u{i}_{j}\""))))),
        ),
        ("15 MB in one attribute", robot(format!("<link name=\"{}\"/>", "a".repeat(15 << 20)))),
        (
            "15 MB in one vector",
            robot(format!(
                "<link name=\"a\"/><joint name=\"j\" type=\"fixed\"><parent link=\"a\"/><child link=\"a\"/><origin xyz=\"{}\"/></joint>",
                "1 ".repeat(7 << 20)
            )),
        ),
        ("60 attributes each", robot(slots(30_000, &|_| format!("<x{}/>", slots(60, &|j| format!(" a{j}=\"\"")))))),
    ];
    for (what, text) in cases {
        let start = Instant::now();
        let result = Model::from_urdf_str(&text, &ModelOptions::default());
        let took = start.elapsed();
        let answer = result.map_or_else(|e| e.to_string(), |m| format!("{} joints", m.n()));
        println!("{what}: {took:.2?}: {}", answer.chars().take(120).collect::<String>());
        assert!(took.as_secs() < 20, "{what}: {took:?}");
        assert!(answer.len() < 20_000, "{what}: a message of {} bytes", answer.len());
    }
}

//! Names of enum variants, identical in Rust, Python, configurations and logs.

use std::fmt;
use std::str::FromStr;

use crate::error::Error;
use crate::kinematics::Reference;
use crate::params::{CompliantSide, Follow, Law, LimitRule, LimitType, OnDeviationLimit, Profile, Projector};

/// Implements conversion between an enum and the names of its variants; `$key` is the name of the setting in error
/// messages.
macro_rules! words {
    ($($choice:ident of $key:literal: $($word:literal is $variant:ident),+;)+) => { $(
        impl $choice {
            /// All variants, each with its name.
            pub const NAMES: &'static [(&'static str, Self)] = &[$(($word, Self::$variant)),+];
        }

        impl fmt::Display for $choice {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.pad(match self { $(Self::$variant => $word),+ })
            }
        }

        impl FromStr for $choice {
            type Err = Error;

            /// Returns the variant of that name.
            ///
            /// # Errors
            /// [`Error::Config`] with the valid names.
            fn from_str(word: &str) -> Result<Self, Error> {
                let found = Self::NAMES.iter().find(|(known, _)| *known == word);
                found.map(|(_, choice)| *choice).ok_or_else(|| unknown($key, &[$($word),+], word))
            }
        }
    )+ };
}

words! {
    Law of "law": "cap" is Cap, "impedance" is Impedance, "paper" is Paper;
    Follow of "paper_options.follow": "free" is Free, "hold" is Hold;
    LimitRule of "paper_options.limits": "demand" is Demand, "sum" is Sum;
    Projector of "null_space.projector": "exact" is Exact, "paper" is Paper;
    Profile of "profile": "hardening" is Hardening, "constant" is Constant, "softening" is Softening;
    OnDeviationLimit of "on_deviation_limit": "yield" is Yield, "wait" is Wait;
    CompliantSide of "yields": "both" is Both, "+" is Plus, "-" is Minus, "none" is None;
    LimitType of "limit_type": "current" is Current, "pwm" is Pwm;
    Reference of "reference": "world_aligned" is WorldAligned, "local" is Local;
}

#[cold]
fn unknown(key: &str, words: &[&str], got: &str) -> Error {
    let list = words.iter().map(|word| format!("'{word}'")).collect::<Vec<_>>().join(", ");
    Error::config(key, format!("must be one of {list}, got '{got}'"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_parses_to_its_variant() {
        for (word, law) in Law::NAMES {
            assert_eq!((law.to_string().as_str(), word.parse()), (*word, Ok(*law)));
        }
        for (word, yields) in CompliantSide::NAMES {
            assert_eq!((yields.to_string().as_str(), word.parse()), (*word, Ok(*yields)));
        }
        assert_eq!(format!("{:>8}|{:<6}|", LimitType::Pwm, Law::Cap), "     pwm|cap   |");
    }

    #[test]
    fn an_unknown_name_is_rejected_with_the_valid_names() {
        let message = "Cap".parse::<Law>().unwrap_err().to_string();
        assert_eq!(message, "law: must be one of 'cap', 'impedance', 'paper', got 'Cap'");
    }
}

//! Where rigid bones glide past each other, so that the motion of the tissue between them may be discontinuous.

use super::anatomy::Kind;
use serde::{Deserialize, Serialize};

/// Two kinds of bones that slide on each other, with bursae or muscle planes in between.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sliding {
    /// Name, for reports.
    pub name: String,
    /// The two kinds: names of bones, or what several names begin with (`rib` is every rib, `rib_left` those of the left).
    pub between: [String; 2],
}

/// All declared sliding interfaces.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SlidingOptions {
    /// The interfaces; a list in the settings replaces this one.
    pub interfaces: Vec<Sliding>,
}

/// Jaw joint, shoulder joint, scapula on the ribs, and the arm that lies on the thorax.
const DECLARED: [(&str, [&str; 2]); 6] = [
    ("jaw joint", ["skull", "mandible"]),
    ("shoulder joint", ["scapula", "humerus"]),
    ("scapula on ribs", ["scapula", "rib"]),
    ("arm on thorax", ["humerus", "rib"]),
    ("arm on thorax", ["ulna", "rib"]),
    ("arm on thorax", ["radius", "rib"]),
];

impl Default for SlidingOptions {
    fn default() -> Self {
        let of = |(name, between): &(&str, [&str; 2])| Sliding {
            name: (*name).to_owned(),
            between: between.map(str::to_owned),
        };
        Self { interfaces: DECLARED.iter().map(of).collect() }
    }
}

impl SlidingOptions {
    /// Labels of all pairs of `bones` (label and name) that slide on each other. Bones of two sides never do.
    pub fn pairs(&self, bones: &[(u16, String)]) -> Vec<[u16; 2]> {
        let mut out = Vec::new();
        for (n, (label, name)) in bones.iter().enumerate() {
            for (other_label, other) in &bones[n + 1..] {
                let declared = |s: &Sliding| {
                    let [a, b] = &s.between;
                    (is(name, a) && is(other, b)) || (is(name, b) && is(other, a))
                };
                let sides = side(name).zip(side(other)).is_some_and(|(a, b)| a != b);
                if !sides && self.interfaces.iter().any(declared) {
                    out.push([*label, *other_label]);
                }
            }
        }
        out
    }

    /// The first kind of bone that does not exist, if any.
    pub fn problem(&self) -> Option<String> {
        let unknown = |s: &Sliding| s.between.iter().find(|k| !Kind::names().iter().any(|n| is(n, k))).cloned();
        self.interfaces.iter().find_map(|s| {
            let kind = unknown(s)?;
            Some(format!("sliding.interfaces, {:?}: no bone is named {kind:?} or begins with it", s.name))
        })
    }
}

/// Whether a bone is of a kind: has its name, or a name that continues it.
fn is(name: &str, kind: &str) -> bool {
    name.strip_prefix(kind).is_some_and(|rest| !kind.is_empty() && (rest.is_empty() || rest.starts_with('_')))
}

/// The side that a bone's name tells.
fn side(name: &str) -> Option<&str> {
    name.split('_').find(|part| matches!(*part, "left" | "right"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bones_of_one_side_slide_and_others_do_not() {
        let names = ["skull", "mandible", "scapula_left", "rib_left_2", "rib_right_2", "vertebrae_T2", "humerus_right"];
        let bones: Vec<(u16, String)> = (10..).zip(names.map(str::to_owned)).collect();
        let pairs = SlidingOptions::default().pairs(&bones);
        assert_eq!(pairs, [[10, 11], [12, 13], [14, 16]]);
        let own = SlidingOptions {
            interfaces: vec![Sliding { name: "neck".into(), between: ["vertebrae".into(), "rib_left".into()] }],
        };
        assert_eq!(own.pairs(&bones), [[13, 15]]);
        assert!(SlidingOptions { interfaces: Vec::new() }.pairs(&bones).is_empty());
    }

    #[test]
    fn kinds_that_no_bone_has_are_refused() {
        assert_eq!(SlidingOptions::default().problem(), None);
        for wrong in ["scapla", "ri", ""] {
            let between = ["skull".to_owned(), wrong.to_owned()];
            let options = SlidingOptions { interfaces: vec![Sliding { name: "x".into(), between }] };
            assert!(options.problem().unwrap().contains(&format!("{wrong:?}")));
        }
    }
}

//! Where rigid bones glide past each other, so that the motion of the tissue between them may be discontinuous.

use super::anatomy::Kind;
use serde::{Deserialize, Serialize};

/// Two kinds of bones that slide on each other, with bursae or muscle planes in between.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sliding {
    /// Name, for reports.
    pub name: String,
    /// The two kinds: names of bones, or what several names begin with (`rib` is every rib, `rib_left` those of the left).
    pub between: [String; 2],
    /// Farthest from both bones that the interface reaches, mm.
    pub reach_mm: f64,
}

/// All declared sliding interfaces.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SlidingOptions {
    /// The interfaces; a list in the settings replaces this one.
    pub interfaces: Vec<Sliding>,
}

/// Jaw joint, shoulder joint, scapula on the ribs, and the arm that lies on the thorax. Reaches: joint spaces with their capsule;
/// half of the muscles under the scapula; half of the soft tissue between the shaft of the humerus and the ribs.
const DECLARED: [(&str, [&str; 2], f64); 6] = [
    ("jaw joint", ["skull", "mandible"], 6.0),
    ("shoulder joint", ["scapula", "humerus"], 10.0),
    ("scapula on ribs", ["scapula", "rib"], 15.0),
    ("arm on thorax", ["humerus", "rib"], 40.0),
    ("arm on thorax", ["ulna", "rib"], 40.0),
    ("arm on thorax", ["radius", "rib"], 40.0),
];

impl Default for SlidingOptions {
    fn default() -> Self {
        let of = |(name, between, reach_mm): &(&str, [&str; 2], f64)| Sliding {
            name: (*name).to_owned(),
            between: between.map(str::to_owned),
            reach_mm: *reach_mm,
        };
        Self { interfaces: DECLARED.iter().map(of).collect() }
    }
}

impl SlidingOptions {
    /// Labels of all pairs of `bones` (label and name) that slide on each other, with the reach of the interface in mm.
    /// Bones of two sides never do.
    pub fn pairs(&self, bones: &[(u16, String)]) -> Vec<([u16; 2], f64)> {
        let mut out = Vec::new();
        for (n, (label, name)) in bones.iter().enumerate() {
            for (other_label, other) in &bones[n + 1..] {
                let declared = |s: &Sliding| {
                    let [a, b] = &s.between;
                    (is(name, a) && is(other, b)) || (is(name, b) && is(other, a))
                };
                let sides = side(name).zip(side(other)).is_some_and(|(a, b)| a != b);
                if let Some(s) = self.interfaces.iter().find(|s| !sides && declared(s)) {
                    out.push(([*label, *other_label], s.reach_mm));
                }
            }
        }
        out
    }

    /// The first kind of bone that does not exist or reach that is no length, if any.
    pub fn problem(&self) -> Option<String> {
        let unknown = |s: &Sliding| s.between.iter().find(|k| !Kind::names().iter().any(|n| is(n, k))).cloned();
        self.interfaces.iter().find_map(|s| {
            if !(0.0..=200.0).contains(&s.reach_mm) {
                let (name, reach) = (&s.name, s.reach_mm);
                return Some(format!("sliding.interfaces, {name:?}: reach_mm is {reach}: it must lie in [0, 200]"));
            }
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
        assert_eq!(pairs, [([10, 11], 6.0), ([12, 13], 15.0), ([14, 16], 40.0)]);
        let own = SlidingOptions {
            interfaces: vec![Sliding {
                name: "neck".into(),
                between: ["vertebrae".into(), "rib_left".into()],
                reach_mm: 5.0,
            }],
        };
        assert_eq!(own.pairs(&bones), [([13, 15], 5.0)]);
        assert!(SlidingOptions { interfaces: Vec::new() }.pairs(&bones).is_empty());
    }

    #[test]
    fn kinds_that_no_bone_has_are_refused() {
        assert_eq!(SlidingOptions::default().problem(), None);
        for wrong in ["scapla", "ri", ""] {
            let between = ["skull".to_owned(), wrong.to_owned()];
            let options = SlidingOptions { interfaces: vec![Sliding { name: "x".into(), between, reach_mm: 5.0 }] };
            assert!(options.problem().unwrap().contains(&format!("{wrong:?}")));
        }
    }
}

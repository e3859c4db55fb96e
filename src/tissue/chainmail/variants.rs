//! The choices by which variants of the chain mail differ: where a front runs, what it does first, what it hands on.

use serde::{Deserialize, Serialize};

/// How long a front takes along a link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LinkTime {
    /// Length / shear: stiff tissue is slow (thesis eq. in 5.2.2, in units of length so that spacing does not matter).
    #[default]
    SlowInStiff,
    /// Length * shear: stiff tissue is fast (the text of thesis 2.4 and Fig. 14).
    FastInStiff,
    /// 1 / (length * shear): eq. in 5.2.2 to the letter, whose constraints are multiplied by the link's length.
    Literal,
}

/// Which links a front runs along.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Front {
    /// 26 links, each by its length: at most 13 % too long on cubes, 9 % on the mean; 25 and 16 % on voxels three times as high.
    #[default]
    Round,
    /// 6 links: rhombus fronts (thesis Fig. 14, 15).
    Rhombus,
}

/// Which element is processed next.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// Least time along the path first (thesis 5.2.2).
    #[default]
    Timestamps,
    /// Largest constraint violation first: the enhanced chain mail (thesis 5.2.1, eq. 2.7).
    ConstraintViolation,
    /// First moved, first processed: the original chain mail, for homogeneous material (thesis 2.4).
    FirstMoved,
}

/// Sorting criteria after the time, with averaging along wave fronts (thesis 5.5).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Structures {
    /// Time only: an element takes what arrives first.
    #[default]
    None,
    /// Elements with more informations first, averaged by eq. 5.9-5.10: cures L-shapes.
    SecondCriterion,
    /// Then elements nearest along the front to where informations first met: cures U-shapes.
    ThirdCriterion,
}

/// What a bone hands to the tissue around it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Carry {
    /// Its rigid motion, undiminished: the blend of several bones does the rest.
    #[default]
    Rigid,
    /// The displacement of each of its elements as a translation, reduced by the play of each link: the chain mail
    /// without rotation (thesis 2.4).
    Translation,
    /// An orientation whose valid regions turn with it and limit both position and angle (thesis 5.3.1, eq. 5.1-5.2).
    ConstraintBased,
    /// Its translation, reduced by the play of each link, and its rotation about the bone's centroid with linear decay
    /// (thesis 5.3.2, eq. 5.3-5.6, on displacements so that the bone itself moves exactly).
    LinearDecay,
}

/// What pulls the elements in the relaxation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Elasticity {
    /// 26 links that turn with the tissue, stiffer where their play is less.
    #[default]
    Corotated,
    /// 6 equal links that do not turn: an element moves to the mean of the places where its neighbours want it.
    Gibson,
    /// 6 links that do not turn, stiffer where their play is less.
    Heterogeneous,
}

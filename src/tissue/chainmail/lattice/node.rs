//! What an element is.

/// What a node is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Node {
    /// Air or outside the patient: takes no part.
    Outside,
    /// Soft tissue, or rigid material without a bone label.
    Soft,
    /// Part of a bone (position in the skeleton): an initiator.
    Bone(u16),
}

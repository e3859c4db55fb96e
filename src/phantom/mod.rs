//! phantom (under construction)

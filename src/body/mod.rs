//! body (under construction)

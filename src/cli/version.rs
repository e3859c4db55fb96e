//! What `aventail --version` tells beside the number: of which sources it was built, and what of this machine it uses.

use crate::geometry::simd;
use std::sync::LazyLock;

/// The number, the build, the target and the vector instructions in use.
///
/// `AVENTAIL_BUILD` is set by whoever makes a release, to the revision of the sources.
pub(super) fn long() -> &'static str {
    static TEXT: LazyLock<String> = LazyLock::new(|| {
        let build = option_env!("AVENTAIL_BUILD").map_or(String::new(), |b| format!(" ({b})"));
        let (os, arch) = (std::env::consts::OS, std::env::consts::ARCH);
        let unoptimised = if cfg!(debug_assertions) { ", with debug assertions" } else { "" };
        format!("{}{build}\n{arch} {os}, {} in use{unoptimised}", env!("CARGO_PKG_VERSION"), simd())
    });
    &TEXT
}

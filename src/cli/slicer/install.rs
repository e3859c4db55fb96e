//! The folder that Slicer loads.

use crate::error::{Error, Result};
use crate::io::{whole_path, write_file};
use std::path::Path;

/// Name of the module's file: Slicer shows the title of the description, and knows the module by this name.
const NAME: &str = "AventailRegister";

/// Writes the file that Slicer runs; returns what to do next.
pub(super) fn run(folder: &Path) -> Result<String> {
    let program =
        std::env::current_exe().map_err(|e| Error::Internal(format!("cannot find the path of this program: {e}")))?;
    std::fs::create_dir_all(folder)
        .map_err(|e| Error::write(folder, e.to_string(), "choose a folder that you may write to"))?;
    let (name, text) = script(&program)?;
    let file = folder.join(name);
    write_file(&file, |out| out.write_all(text.as_bytes()))?;
    executable(&file)?;
    Ok(format!(
        "Wrote {}.\nIn Slicer open Edit, Application Settings, Modules; add this folder to Additional module paths:\n  {}\n\
         Restart Slicer. The module is in the category Registration: Articulated Registration (aventail).",
        file.display(),
        whole_path(folder).unwrap_or_else(|_| folder.to_owned()).display()
    ))
}

/// A script that calls the program where it lies.
#[cfg(not(windows))]
fn script(program: &Path) -> Result<(String, String)> {
    let path = program.to_str().filter(|p| !p.contains('\n')).ok_or_else(|| {
        let problem = format!("{}: a script cannot hold this path", program.display());
        Error::usage(problem, "move the program, then install again")
    })?;
    let quoted = format!("'{}'", path.replace('\'', r"'\''"));
    Ok((NAME.into(), format!("#!/bin/sh\nexec {quoted} slicer register \"$@\"\n")))
}

#[cfg(windows)]
fn script(program: &Path) -> Result<(String, String)> {
    // A percent sign begins a variable in such a file.
    let path = program.display().to_string().replace('%', "%%");
    // Such a file is read in the console's own code page, which has no letters of other languages.
    let letters = if path.is_ascii() { "" } else { "@chcp 65001 >nul\r\n" };
    Ok((format!("{NAME}.bat"), format!("{letters}@\"{path}\" slicer register %*\r\n")))
}

#[cfg(unix)]
fn executable(file: &Path) -> Result<()> {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(file, std::fs::Permissions::from_mode(0o755))
        .map_err(|e| Error::write(file, e.to_string(), "choose a folder whose files may be run"))
}

#[cfg(not(unix))]
fn executable(_: &Path) -> Result<()> {
    Ok(())
}

//! Which series a path means, and inputs that are folders.

use super::make::*;
use crate::io::checksum::{require_file, sha256_file};
use crate::io::{check_files, read_image};
use dicom_core::VR;
use dicom_dictionary_std::{tags, uids};

#[test]
fn a_slice_means_its_series_and_a_number_one_of_several() {
    let dir = series(|_, _| ());
    let alone = read_image(dir.path()).unwrap();
    for k in 0..3 {
        let mut other = slice(k);
        put(&mut other, tags::SERIES_INSTANCE_UID, VR::UI, "1.7.31");
        put(&mut other, tags::SERIES_NUMBER, VR::IS, "31");
        put(&mut other, tags::SERIES_DESCRIPTION, VR::LO, "thorax");
        put(&mut other, tags::SOP_INSTANCE_UID, VR::UI, &format!("1.5.3{k}"));
        write(dir.path(), &format!("other{k}"), &other);
    }
    let error = read_image(dir.path()).unwrap_err();
    let text = error.to_string();
    assert_eq!(error.code(), "dicom-several");
    for word in ["series 31: CT of 2026-01-03, thorax, 3 slices", "series 2:", "6 slices", "UID 1.7.31", "#2"] {
        assert!(text.contains(word), "{word}: {text}");
    }
    let at = |choice: &str| format!("{}#{choice}", dir.path().display());
    let chosen = read_image(at("2")).unwrap();
    assert_eq!((&chosen.value, &chosen.sha256), (&alone.value, &alone.sha256));
    assert_eq!(read_image(at("1.7.31")).unwrap().value.grid().size()[2], 3);
    assert!(read_image(at("5")).unwrap_err().to_string().contains("series 31"));
    let by_slice = read_image(dir.path().join("IM3")).unwrap();
    assert_eq!(by_slice.value, alone.value);
    assert_eq!(by_slice.path.display().to_string(), at("1.7.2"));
    assert_eq!(sha256_file(&by_slice.path).unwrap(), by_slice.sha256);
    assert_ne!(sha256_file(at("31")).unwrap(), by_slice.sha256);
}

#[test]
fn other_modalities_are_refused_with_words() {
    for (modality, word) in
        [("MR", "no MR image"), ("PT", "PET"), ("RTIMAGE", "projection"), ("RTSTRUCT", "structure set")]
    {
        let dir = tempfile::tempdir().unwrap();
        let mut set = base("1.2.3", "1.5.1", "1.7.9", modality);
        put(&mut set, tags::SERIES_DESCRIPTION, VR::LO, "other");
        let path = write(dir.path(), "a", &set);
        let error = read_image(&path).unwrap_err();
        assert!(error.code() == "dicom-no-ct" && error.to_string().contains(word), "{error}");
        let error = read_image(dir.path()).unwrap_err();
        assert!(
            error.code() == "dicom-no-ct" && error.to_string().contains(&format!("series 9: {modality}")),
            "{error}"
        );
    }
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("notes.txt"), "text").unwrap();
    for refused in [read_image(dir.path()).map(drop), require_file(dir.path()), sha256_file(dir.path()).map(drop)] {
        let error = refused.unwrap_err();
        assert!(error.exit_code() == 3 && error.to_string().contains("folder without DICOM"), "{error}");
    }
}

#[test]
fn files_without_preamble_or_meta_information_are_read() {
    let dir = series(|_, _| ());
    let expected = read_image(dir.path()).unwrap().value;
    for (k, entry) in std::fs::read_dir(dir.path()).unwrap().flatten().enumerate() {
        let bytes = std::fs::read(entry.path()).unwrap();
        // Without preamble; without preamble and mark; the data set alone.
        let length = u32::from_le_bytes(bytes[140..144].try_into().unwrap()) as usize;
        let from = [128, 132, 144 + length][k % 3];
        std::fs::write(entry.path(), &bytes[from..]).unwrap();
    }
    assert_eq!(read_image(dir.path()).unwrap().value, expected);
    let implicit = tempfile::tempdir().unwrap();
    for k in 0..SIZE[2] {
        let path = write_as(implicit.path(), &k.to_string(), &slice(k), uids::IMPLICIT_VR_LITTLE_ENDIAN);
        let bytes = std::fs::read(&path).unwrap();
        let length = u32::from_le_bytes(bytes[140..144].try_into().unwrap()) as usize;
        std::fs::write(&path, &bytes[144 + length..]).unwrap();
    }
    assert_eq!(read_image(implicit.path()).unwrap().value, expected);
}

#[test]
fn results_do_not_take_the_place_of_a_series() {
    let dir = series(|_, _| ());
    let (folder, slice) = (dir.path(), dir.path().join("IM3"));
    let choice = std::path::PathBuf::from(format!("{}#2", folder.display()));
    std::fs::write(folder.join("notes.txt"), "text").unwrap();
    for input in [folder, slice.as_path(), choice.as_path()] {
        for output in ["IM3", "IM10"] {
            let error = check_files(&[input], &[folder.join(output)]).unwrap_err();
            assert_eq!(error.code(), "input-overwritten", "{error}");
        }
        check_files(&[input], &[folder.join("new.nii.gz"), folder.join("notes.txt")]).unwrap();
    }
    let gone = std::path::PathBuf::from("nowhere#2");
    assert!(check_files(&[&gone], &[]).unwrap_err().to_string().contains("no such file"));
}

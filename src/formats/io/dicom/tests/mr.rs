//! MR series: read in their own grey values, one contrast at a time.

use super::super::like::Like;
use super::super::{About, Scan, read_series, require_ct, scan_of, summary};
use super::make::*;
use crate::findings;
use crate::io::checksum::sha256_file;
use crate::io::inspect::inspect;
use crate::io::{read_grid, read_image, read_scan};
use crate::volume::contour::{Contours, Polygon, Structure};
use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::tags;
use nalgebra::Matrix3;
use std::path::Path;

const MR: &str = "1.2.840.10008.5.1.4.1.1.4";
const ENHANCED_MR: &str = "1.2.840.10008.5.1.4.1.1.4.1";

/// Slice `k` of an MR of the same geometry, as a scanner that writes no slope does.
fn magnitude(k: usize) -> Set {
    let mut set = slice(k);
    put(&mut set, tags::SOP_CLASS_UID, VR::UI, MR);
    put(&mut set, tags::MODALITY, VR::CS, "MR");
    put(&mut set, tags::IMAGE_TYPE, VR::CS, "ORIGINAL\\PRIMARY\\M\\ND\\NORM");
    put(&mut set, tags::ECHO_TIME, VR::DS, "9.2");
    put(&mut set, tags::ECHO_NUMBERS, VR::IS, "1");
    // Odd slices are measured after all even ones.
    put(&mut set, tags::ACQUISITION_TIME, VR::TM, if k % 2 == 0 { "101500" } else { "101830" });
    for tag in [tags::RESCALE_SLOPE, tags::RESCALE_INTERCEPT, tags::RESCALE_TYPE] {
        set.remove_element(tag);
    }
    set
}

/// A series of six such slices, each changed, in a folder.
fn mr_in(folder: &Path, name: &str, change: impl Fn(usize, &mut Set)) {
    for k in 0..SIZE[2] {
        let mut set = magnitude(k);
        change(k, &mut set);
        write(folder, &format!("{name}{}", (k * 7 + 3) % 11), &set);
    }
}

fn mr(change: impl Fn(usize, &mut Set)) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    mr_in(dir.path(), "IM", change);
    dir
}

/// Makes an image one of another series.
fn other(set: &mut Set, number: &str, k: usize) {
    put(set, tags::SERIES_INSTANCE_UID, VR::UI, &format!("1.7.{number}"));
    put(set, tags::SERIES_NUMBER, VR::IS, number);
    put(set, tags::SOP_INSTANCE_UID, VR::UI, &format!("1.5.{number}.{k}"));
}

/// The refusal of a series that is changed so.
fn refused(code: &str, words: &[&str], change: impl Fn(usize, &mut Set)) {
    let dir = mr(change);
    let error = read_scan(dir.path()).unwrap_err();
    let text = error.to_string();
    assert_eq!((error.code(), error.exit_code()), (code, 4), "{text}");
    words.iter().for_each(|word| assert!(text.contains(word), "{word}: {text}"));
}

#[test]
fn a_series_is_read_in_stored_values_and_where_a_ct_is_needed_refused() {
    let dir = mr(|_, _| ());
    let read = read_scan(dir.path()).unwrap();
    let grid = read.value.grid();
    assert_eq!((grid.size(), grid.spacing(), grid.origin()), (SIZE, [1.5, 2.0, 3.0], [-10.0, -20.0, 30.0].into()));
    for at in 0..grid.len() {
        let [i, j, k] = grid.voxel(at);
        assert_eq!(read.value.data()[at], f32::from(stored(i, j, k)), "{i} {j} {k}");
    }
    assert!(read.warnings.is_empty() && read.header.format == "DICOM MR", "{:?}", read.warnings);
    assert_eq!(sha256_file(dir.path()).unwrap(), read.sha256);
    assert!(read_grid(dir.path()).unwrap().0.matches(grid, 1e-9));
    let (volume, series) = read_series(dir.path()).unwrap().value;
    assert_eq!((&volume, series.modality.as_str(), series.sop_class.as_str()), (&read.value, "MR", MR));
    assert_eq!(About::of(dir.path()).unwrap().slices, SIZE[2]);
    assert_eq!(scan_of(dir.path()).unwrap(), Some(Scan::Mr));
    let by_slice = dir.path().join("IM3");
    assert_eq!((read_scan(&by_slice).unwrap().value, scan_of(&by_slice).unwrap()), (volume, Some(Scan::Mr)));
    inspect(&by_slice).unwrap();
    for error in [read_image(dir.path()).unwrap_err(), require_ct(dir.path()).unwrap_err()] {
        assert!(error.code() == "dicom-no-ct" && error.to_string().contains("MR series"), "{error}");
    }
    let text = summary(dir.path(), false).unwrap().to_string();
    assert!(text.contains("6 slices, 5 x 4 x 6, 1.5 x 2 x 3 mm") && !text.contains("problem"), "{text}");
    let ct = super::make::series(|_, _| ());
    assert_eq!(scan_of(ct.path()).unwrap(), Some(Scan::Ct));
    require_ct(ct.path()).unwrap();
    assert_eq!(read_scan(ct.path()).unwrap().value, read_image(ct.path()).unwrap().value);
}

#[test]
fn slopes_of_each_slice_are_applied_and_what_was_not_measured_shows_no_signal() {
    let dir = mr(|k, set| {
        put(set, tags::RESCALE_SLOPE, VR::DS, if k == 4 { "0.5" } else { "2" });
        put(set, tags::RESCALE_INTERCEPT, VR::DS, "3");
        put(set, tags::RESCALE_TYPE, VR::LO, "normalized");
        set.put(DataElement::new(tags::PIXEL_PADDING_VALUE, VR::US, PrimitiveValue::from(stored(0, 0, 2))));
    });
    let read = read_scan(dir.path()).unwrap();
    for at in 0..read.value.grid().len() {
        let voxel @ [i, j, k] = read.value.grid().voxel(at);
        let grey = f32::from(stored(i, j, k)) * if k == 4 { 0.5 } else { 2.0 } + 3.0;
        assert_eq!(read.value.data()[at], if voxel == [0, 0, 2] { 0.0 } else { grey }, "{voxel:?}");
    }
    let codes: Vec<&str> = read.warnings.iter().map(|w| w.code.as_str()).collect();
    assert_eq!(codes, ["dicom-padding"]);
    // A slope that some slices lack leaves their values on two scales; one without intercept is damaged.
    refused("dicom-acquisitions", &["Rescale Slope some: 2 images", "Rescale Slope none: 4 images"], |k, set| {
        if k > 3 {
            put(set, tags::RESCALE_SLOPE, VR::DS, "2");
            put(set, tags::RESCALE_INTERCEPT, VR::DS, "0");
        }
    });
    refused("dicom-incomplete", &["Rescale Slope and Rescale Intercept"], |_, set| {
        put(set, tags::RESCALE_SLOPE, VR::DS, "2");
    });
    refused("dicom-gap", &["a slice is missing between z = 36.00 mm and z = 42.00 mm"], |k, set| {
        let z = 30.0 + 3.0 * (k + usize::from(k > 2)) as f64;
        put(set, tags::IMAGE_POSITION_PATIENT, VR::DS, &list(&[-10.0, -20.0, z]));
    });
}

#[test]
fn maps_and_parts_of_complex_images_are_refused_by_name() {
    for (image_type, word) in [
        ("DERIVED\\PRIMARY\\DIFFUSION\\ADC\\ND\\NORM", "a diffusion map"),
        ("DERIVED\\PRIMARY\\DIFFUSION\\TRACEW\\ND", "a diffusion map"),
        ("ORIGINAL\\PRIMARY\\PHASE MAP\\P\\FFE", "a phase image"),
        ("ORIGINAL\\PRIMARY\\P\\ND", "a phase image"),
        ("ORIGINAL\\PRIMARY\\R_IR\\R\\IR", "the real part"),
        ("ORIGINAL\\PRIMARY\\I_FFE\\I\\FFE", "the imaginary part"),
        ("DERIVED\\PRIMARY\\T1 MAP\\T1\\UNSPECIFIED", "a map of a quantity"),
        ("DERIVED\\PRIMARY\\M\\T2_STAR_MAP", "a map of a quantity"),
        ("DERIVED\\PRIMARY\\R2*", "a map of relaxation"),
        ("DERIVED\\PRIMARY\\PERFUSION\\CBV", "a perfusion map"),
        ("DERIVED\\PRIMARY\\M\\ND\\SUB", "a subtraction"),
        ("DERIVED\\SECONDARY\\PROJECTION IMAGE\\MIP", "a projection"),
        ("ORIGINAL\\PRIMARY\\M\\ND\\MOSAIC", "a mosaic"),
        ("DERIVED\\PRIMARY\\DIXON\\FAT_FRACTION", "fat or water fraction"),
    ] {
        refused("mr-derived-map", &[word, image_type, "magnitude"], |_, set| {
            put(set, tags::IMAGE_TYPE, VR::CS, image_type);
        });
    }
    refused("mr-derived-map", &["a phase image"], |_, set| {
        put(set, tags::COMPLEX_IMAGE_COMPONENT, VR::CS, "PHASE");
    });
    // GE says it in an element of its own.
    refused("mr-derived-map", &["the real part"], |_, set| {
        put(set, tags::IMAGE_TYPE, VR::CS, "ORIGINAL\\PRIMARY\\OTHER");
        put(set, dicom_core::Tag(0x0043, 0x0010), VR::LO, "GEMS_PARM_01");
        set.put(DataElement::new(dicom_core::Tag(0x0043, 0x102f), VR::SS, PrimitiveValue::from(2i16)));
    });
    for image_type in [
        "ORIGINAL\\PRIMARY\\M_FFE\\M\\FFE",
        "ORIGINAL\\PRIMARY\\OTHER",
        "DERIVED\\PRIMARY\\M\\DIXON\\WATER",
        "DERIVED\\PRIMARY\\M\\DIXON\\IN_PHASE",
        "DERIVED\\SECONDARY\\MPR\\CSA MPR",
        "ORIGINAL\\PRIMARY\\T1\\NONE",
    ] {
        let dir = mr(|_, set| put(set, tags::IMAGE_TYPE, VR::CS, image_type));
        assert!(read_scan(dir.path()).unwrap().warnings.is_empty(), "{image_type}");
    }
}

#[test]
fn beside_maps_the_anatomy_is_chosen_and_named_and_a_ct_comes_first() {
    let dir = mr(|_, _| ());
    let alone = read_scan(dir.path()).unwrap();
    mr_in(dir.path(), "ADC", |k, set| {
        other(set, "31", k);
        put(set, tags::IMAGE_TYPE, VR::CS, "DERIVED\\PRIMARY\\DIFFUSION\\ADC");
    });
    assert_eq!(read_scan(dir.path()).unwrap().value, alone.value);
    let at = |choice: &str| format!("{}#{choice}", dir.path().display());
    let error = read_scan(at("31")).unwrap_err();
    let text = error.to_string();
    assert!(error.code() == "mr-derived-map" && text.contains("series 2: MR of 2026-01-03"), "{text}");
    mr_in(dir.path(), "T2", |k, set| other(set, "32", k));
    let error = read_scan(dir.path()).unwrap_err();
    let text = error.to_string();
    assert!(
        error.code() == "dicom-several" && text.contains("it holds 2 MR series") && !text.contains("1.7.31"),
        "{text}"
    );
    let shown = summary(dir.path(), false).unwrap().to_string();
    assert!(shown.contains("several MR series") && shown.contains("[mr-derived-map]"), "{shown}");
    for k in 0..SIZE[2] {
        let mut set = slice(k);
        other(&mut set, "33", k);
        write(dir.path(), &format!("CT{k}"), &set);
    }
    assert_eq!(scan_of(dir.path()).unwrap(), Some(Scan::Ct));
    assert_eq!(read_image(dir.path()).unwrap().value, read_scan(dir.path()).unwrap().value);
    assert_eq!(read_scan(at("2")).unwrap().value, alone.value);
}

#[test]
fn several_echoes_times_or_kinds_in_one_series_are_refused_and_listed() {
    // Twice at each place.
    let twice = |change: &dyn Fn(&mut Set)| {
        let dir = mr(|_, _| ());
        mr_in(dir.path(), "more", |k, set| {
            put(set, tags::SOP_INSTANCE_UID, VR::UI, &format!("1.5.9.{k}"));
            pixels(set, vec![7; SIZE[0] * SIZE[1]]);
            change(set);
        });
        let error = read_scan(dir.path()).unwrap_err();
        (error.code(), error.to_string())
    };
    for (tag, vr, value, words) in [
        (tags::ECHO_TIME, VR::DS, "82", ["echo time 82.00 ms: 6 images", "echo time 9.20 ms: 6 images"]),
        (tags::ECHO_NUMBERS, VR::IS, "2", ["echo 1: 6 images", "echo 2: 6 images"]),
        (tags::TEMPORAL_POSITION_IDENTIFIER, VR::IS, "2", ["temporal position 2: 6 images", "export each"]),
        (tags::IMAGE_TYPE, VR::CS, "DERIVED\\PRIMARY\\M\\DIXON\\FAT", ["DIXON\\FAT: 6 images", "export each"]),
        (
            tags::IMAGE_TYPE,
            VR::CS,
            "ORIGINAL\\PRIMARY\\P\\ND",
            ["keep the images of image type ORIGINAL\\PRIMARY\\M\\ND\\NORM", "P\\ND: 6 images"],
        ),
    ] {
        let (code, text) = twice(&|set| put(set, tag, vr, value));
        assert_eq!(code, "dicom-acquisitions", "{text}");
        words.iter().for_each(|word| assert!(text.contains(word), "{word}: {text}"));
    }
    let (code, text) = twice(&|set| {
        set.put(DataElement::new(tags::DIFFUSION_B_VALUE, VR::FD, PrimitiveValue::from(800.0f64)));
    });
    assert!(code == "dicom-acquisitions" && text.contains("b-value 800 s/mm2: 6 images"), "{text}");
    let (code, text) = twice(&|set| put(set, tags::ACQUISITION_NUMBER, VR::IS, "2"));
    assert!(code == "dicom-duplicates" && text.contains("acquisition 2"), "{text}");
}

#[test]
fn an_enhanced_mr_is_read_by_its_frames_and_its_echoes_are_told_apart() {
    let item = |fill: &dyn Fn(&mut Set)| {
        let mut item = Set::new_empty();
        fill(&mut item);
        vec![item]
    };
    let enhanced = |kind: &str, echo: &dyn Fn(usize) -> f64| {
        let mut set = base(ENHANCED_MR, "1.5.70", "1.7.2", "MR");
        let all = (0..SIZE[2]).flat_map(|k| (0..SIZE[1]).flat_map(move |j| (0..SIZE[0]).map(move |i| stored(i, j, k))));
        pixels(&mut set, all.collect());
        put(&mut set, tags::IMAGE_TYPE, VR::CS, "ORIGINAL\\PRIMARY\\VOLUME\\MIXED");
        put(&mut set, tags::NUMBER_OF_FRAMES, VR::IS, &SIZE[2].to_string());
        let mut shared = Set::new_empty();
        put_items(&mut shared, tags::PIXEL_MEASURES_SEQUENCE, item(&|g| put(g, tags::PIXEL_SPACING, VR::DS, "2\\1.5")));
        let straight = |g: &mut Set| put(g, tags::IMAGE_ORIENTATION_PATIENT, VR::DS, "1\\0\\0\\0\\1\\0");
        put_items(&mut shared, tags::PLANE_ORIENTATION_SEQUENCE, item(&straight));
        put_items(&mut set, tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, vec![shared]);
        let frames = (0..SIZE[2]).map(|k| {
            let mut frame = Set::new_empty();
            let place = list(&[-10.0, -20.0, 30.0 + 3.0 * k as f64]);
            let at = |g: &mut Set| put(g, tags::IMAGE_POSITION_PATIENT, VR::DS, &place);
            put_items(&mut frame, tags::PLANE_POSITION_SEQUENCE, item(&at));
            let scale = |g: &mut Set| {
                put(g, tags::RESCALE_SLOPE, VR::DS, "3");
                put(g, tags::RESCALE_INTERCEPT, VR::DS, "0");
                put(g, tags::RESCALE_TYPE, VR::LO, "US");
            };
            put_items(&mut frame, tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE, item(&scale));
            let shows = |g: &mut Set| {
                put(g, tags::FRAME_TYPE, VR::CS, kind);
                put(g, tags::COMPLEX_IMAGE_COMPONENT, VR::CS, "MAGNITUDE");
            };
            put_items(&mut frame, tags::MR_IMAGE_FRAME_TYPE_SEQUENCE, item(&shows));
            let time = |g: &mut Set| {
                g.put(DataElement::new(tags::EFFECTIVE_ECHO_TIME, VR::FD, PrimitiveValue::from(echo(k))));
            };
            put_items(&mut frame, tags::MR_ECHO_SEQUENCE, item(&time));
            frame
        });
        put_items(&mut set, tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, frames.collect());
        let dir = tempfile::tempdir().unwrap();
        write(dir.path(), "enhanced", &set);
        dir
    };
    let dir = enhanced("ORIGINAL\\PRIMARY\\T2\\NONE", &|_| 80.0);
    let (volume, series) = read_series(dir.path()).unwrap().value;
    assert_eq!((volume.grid().size(), volume.grid().spacing()), (SIZE, [1.5, 2.0, 3.0]));
    assert_eq!(volume.data()[volume.grid().linear([4, 3, 5])], 3.0 * f32::from(stored(4, 3, 5)));
    assert_eq!((series.slices[5].frame, series.sop_class.as_str()), (Some(6), ENHANCED_MR));
    let code = |dir: tempfile::TempDir| read_scan(dir.path()).unwrap_err().code();
    let echoes = enhanced("ORIGINAL\\PRIMARY\\T2\\NONE", &|k| if k % 2 == 0 { 20.0 } else { 80.0 });
    assert_eq!(code(echoes), "dicom-acquisitions");
    assert_eq!(code(enhanced("DERIVED\\PRIMARY\\DIFFUSION\\ADC", &|_| 80.0)), "mr-derived-map");
}

#[test]
fn contours_are_written_on_the_images_of_an_mr_and_no_mr_as_a_ct() {
    let dir = mr(|_, _| ());
    let like = Like::read(dir.path()).unwrap();
    let out = tempfile::tempdir().unwrap();
    let file = out.path().join("RS.dcm");
    let points = square(2.0, 33.0).into_iter().map(|[x, y, _]| [x, y]).collect();
    let polygons = vec![Polygon { height: 33.0, points }];
    let structures = vec![Structure { name: "mandible".into(), colour: None, polygons }];
    like.structures(&file, &Contours { axes: Matrix3::identity(), structures }, None).unwrap();
    let object = dicom_object::open_file(&file).unwrap();
    let items = |set: &Set, tag| set.element(tag).unwrap().items().unwrap().to_vec();
    let text = |set: &Set, tag| set.element(tag).unwrap().to_str().unwrap().trim_end_matches('\0').to_owned();
    let frame = &items(&object, tags::REFERENCED_FRAME_OF_REFERENCE_SEQUENCE)[0];
    let study = &items(frame, tags::RT_REFERENCED_STUDY_SEQUENCE)[0];
    let series = &items(study, tags::RT_REFERENCED_SERIES_SEQUENCE)[0];
    let images = items(series, tags::CONTOUR_IMAGE_SEQUENCE);
    assert_eq!(images.len(), SIZE[2]);
    assert!(images.iter().all(|image| text(image, tags::REFERENCED_SOP_CLASS_UID) == MR), "all are MR images");
    let drawn = &items(&object, tags::ROI_CONTOUR_SEQUENCE)[0];
    let image = &items(&items(drawn, tags::CONTOUR_SEQUENCE)[0], tags::CONTOUR_IMAGE_SEQUENCE)[0];
    let own = [tags::REFERENCED_SOP_CLASS_UID, tags::REFERENCED_SOP_INSTANCE_UID].map(|tag| text(image, tag));
    assert_eq!(own, [MR, "1.5.1"]);
    // Between an MR and a CT of another frame of reference.
    let ct = super::make::series(|k, set| {
        other(set, "3", k);
        put(set, tags::FRAME_OF_REFERENCE_UID, VR::UI, "1.88");
    });
    let planning = Like::read(ct.path()).unwrap();
    let grey = read_scan(dir.path()).unwrap().value;
    let file = out.path().join("REG.dcm");
    like.field(&file, &grey.map(|_| [1.0, 0.0, 0.0]), &planning).unwrap();
    let object = dicom_object::open_file(&file).unwrap();
    let series = items(&object, tags::REFERENCED_SERIES_SEQUENCE);
    let classes =
        series.iter().map(|s| text(&items(s, tags::REFERENCED_INSTANCE_SEQUENCE)[0], tags::REFERENCED_SOP_CLASS_UID));
    assert!(classes.eq([MR, CT]), "{series:?}");
    // An image as DICOM is a CT in HU.
    let error = planning.image(&out.path().join("ct"), &grey, Some(dir.path())).unwrap_err();
    assert!(error.is(findings::DICOM_NO_CT) && !out.path().join("ct").exists(), "{error}");
    like.image(&out.path().join("ct"), &grey, Some(ct.path())).unwrap();
    assert_eq!(scan_of(&out.path().join("ct")).unwrap(), Some(Scan::Ct));
}

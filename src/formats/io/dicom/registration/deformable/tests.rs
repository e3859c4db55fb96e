//! Deformable Spatial Registrations against a reader written after the text of the standard.

use super::*;
use crate::geometry::about as turn_about;
use crate::io::dicom::fixture::{items, numbers, oblique, open, origin, series_in, string};
use crate::volume::trilinear_vector;

fn wavy(grid: &Grid) -> Volume<[f32; 3]> {
    Volume::from_fn(grid.clone(), |n| {
        let [i, j, k] = grid.voxel(n).map(|v| v as f32);
        [3.0 * (0.7 * j).sin() - 2.5, 0.4 * i * k - 10.0, (0.9 * i + 0.3 * k).cos() * 8.0]
    })
}

/// A grid that is turned, or turned and mirrored.
fn grids() -> [Grid; 2] {
    let right = oblique([6, 5, 4]);
    let mut mirrored = *right.direction();
    mirrored.column_mut(1).neg_mut();
    let left = Grid::new([6, 5, 4], right.spacing(), right.origin(), mirrored).unwrap();
    [right, left]
}

/// PS3.3 C.20.3.1.1 at any point of the registered frame, from the file alone, written out without this crate's grids and
/// matrices. Vectors are interpolated linearly.
fn standard(object: &InMemDicomObject, x: [f64; 3]) -> [f64; 3] {
    let [item] = items(object, tags::DEFORMABLE_REGISTRATION_SEQUENCE) else { panic!() };
    let matrix = |tag| {
        let [item] = items(item, tag) else { panic!() };
        numbers(item, tags::FRAME_OF_REFERENCE_TRANSFORMATION_MATRIX)
    };
    let apply = |m: &[f64], p: [f64; 3]| {
        [0, 1, 2].map(|r| m[4 * r] * p[0] + m[4 * r + 1] * p[1] + m[4 * r + 2] * p[2] + m[4 * r + 3])
    };
    let [grid] = items(item, tags::DEFORMABLE_REGISTRATION_GRID_SEQUENCE) else { panic!() };
    let start = numbers(grid, tags::IMAGE_POSITION_PATIENT);
    let o = numbers(grid, tags::IMAGE_ORIENTATION_PATIENT);
    let axes = [
        [o[0], o[1], o[2]],
        [o[3], o[4], o[5]],
        [o[1] * o[5] - o[2] * o[4], o[2] * o[3] - o[0] * o[5], o[0] * o[4] - o[1] * o[3]],
    ];
    let resolution = numbers(grid, tags::GRID_RESOLUTION);
    let size = grid.element(tags::GRID_DIMENSIONS).unwrap().to_multi_int::<usize>().unwrap();
    let data = grid.element(tags::VECTOR_GRID_DATA).unwrap().to_multi_float32().unwrap();
    let at: [f64; 3] = [0, 1, 2].map(|a| {
        let along: f64 = (0..3).map(|c| (x[c] - start[c]) * axes[a][c]).sum();
        (along / resolution[a]).clamp(0.0, size[a] as f64 - 1.0)
    });
    let mut d = [0.0; 3];
    for corner in 0..8 {
        let (mut weight, mut index) = (1.0, [0; 3]);
        for a in 0..3 {
            let low = (at[a].floor() as usize).min(size[a] - 2);
            let high = corner >> a & 1;
            let t = at[a] - low as f64;
            weight *= if high == 1 { t } else { 1.0 - t };
            index[a] = low + high;
        }
        let n = index[0] + size[0] * (index[1] + size[1] * index[2]);
        for a in 0..3 {
            d[a] += weight * f64::from(data[3 * n + a]);
        }
    }
    let before = apply(&matrix(tags::PRE_DEFORMATION_MATRIX_REGISTRATION_SEQUENCE), x);
    let moved = [0, 1, 2].map(|a| before[a] + d[a]);
    apply(&matrix(tags::POST_DEFORMATION_MATRIX_REGISTRATION_SEQUENCE), moved)
}

/// Where a field takes a point.
fn ours(field: &Volume<[f32; 3]>, x: &Point3<f64>) -> Point3<f64> {
    x + trilinear_vector(field, &field.grid().index(x)).unwrap()
}

/// Points between the grid's corners.
fn probes(grid: &Grid) -> Vec<Point3<f64>> {
    let [a, b, c] = grid.size().map(|n| n as f64 - 1.0);
    (0..200)
        .map(|n| {
            // Not on the border, where rounding decides.
            let share = |k: f64| 0.001 + 0.998 * (f64::from(n) * k).fract();
            grid.world(&Vector3::new(a * share(0.618), b * share(0.754_877), c * share(0.569_84)))
        })
        .collect()
}

#[test]
fn a_reader_of_the_standard_gets_our_push_and_pull() {
    let dir = tempfile::tempdir().unwrap();
    for grid in grids() {
        let planning = series_in("1.2.3.4", "planning", "1.9.1", &grid);
        let fraction = series_in("1.2.3.4", "fraction", "1.9.2", &grid);
        let field = wavy(&grid);
        let mask = Volume::filled(grid.clone(), true);
        let push = PushField { displacement: field.clone(), computed: mask.clone() };
        let pull = PullField { displacement: field.clone(), inside: mask };
        let [there, back] = ["PUSH.dcm", "PULL.dcm"].map(|n| dir.path().join(n));
        let [from, to] = [&planning, &fraction];
        let about = DerivedRegistration { role: "push", description: "planning to fraction", number: 905, from, to };
        write_push(&there, &push, &about, &origin()).unwrap();
        let about =
            DerivedRegistration { role: "pull", description: "fraction to planning", from: to, to: from, ..about };
        write_pull(&back, &pull, &about, &origin()).unwrap();
        for (path, [from, to]) in [(&there, ["1.9.1", "1.9.2"]), (&back, ["1.9.2", "1.9.1"])] {
            let object = open(path);
            // The grid lies in the frame whose points it takes: the registered one, the object's own.
            assert_eq!(string(&object, tags::FRAME_OF_REFERENCE_UID), from);
            let [item] = items(&object, tags::DEFORMABLE_REGISTRATION_SEQUENCE) else { panic!() };
            assert_eq!(string(item, tags::SOURCE_FRAME_OF_REFERENCE_UID), to);
            for x in probes(&grid) {
                let apart = (Point3::from(standard(&object, x.into())) - ours(&field, &x)).norm();
                assert!(apart < 1e-4, "{apart} mm");
            }
            let read = read_deformable(path).unwrap();
            assert_eq!([read.from.as_str(), read.to.as_str()], [from, to]);
            for x in probes(&grid) {
                assert!((ours(&read.displacement, &x) - ours(&field, &x)).norm() < 1e-4);
            }
        }
    }
}

/// Writes a field and changes the object's registration.
fn changed(path: &Path, mut change: impl FnMut(&mut InMemDicomObject)) {
    let [grid, _] = grids();
    let planning = series_in("1.2.3.4", "planning", "1.9.1", &grid);
    let fraction = series_in("1.2.3.4", "fraction", "1.9.2", &grid);
    let about = DerivedRegistration { role: "d", description: "d", number: 905, from: &fraction, to: &planning };
    write_deformable(path, &wavy(&grid), &about, &origin()).unwrap();
    let mut object = open(path);
    object.update_value(tags::DEFORMABLE_REGISTRATION_SEQUENCE, |v| change(&mut v.items_mut().unwrap()[0]));
    object.write_to_file(path).unwrap();
}

#[test]
fn matrices_before_and_after_become_part_of_the_vectors() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("REG.dcm");
    let turned = |a: f64, b: f64| {
        turn_about(&Point3::new(40.0, 10.0, -700.0), Vector3::new(a, b, 0.2), Vector3::new(12.0, -8.0, 310.0))
            .to_homogeneous()
    };
    let mut sheared = turned(-0.3, 0.1);
    sheared[(0, 1)] += 0.2;
    for (before, after) in
        [(turned(0.1, 0.4), turned(-0.2, 0.3)), (Matrix4::identity(), sheared), (sheared, turned(0.0, 0.1))]
    {
        changed(&path, |o| {
            o.put(sequence(tags::PRE_DEFORMATION_MATRIX_REGISTRATION_SEQUENCE, vec![matrix_item(&before)]));
            o.put(sequence(tags::POST_DEFORMATION_MATRIX_REGISTRATION_SEQUENCE, vec![matrix_item(&after)]));
        });
        let (object, read) = (open(&path), read_deformable(&path).unwrap());
        for x in probes(read.displacement.grid()) {
            let apart = (Point3::from(standard(&object, x.into())) - ours(&read.displacement, &x)).norm();
            assert!(apart < 1e-3, "{apart} mm");
        }
    }
}

#[test]
fn missing_matrices_are_the_identity_and_doubtful_objects_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("REG.dcm");
    let pre = tags::PRE_DEFORMATION_MATRIX_REGISTRATION_SEQUENCE;
    changed(&path, |o| {
        o.remove_element(pre);
        o.put(sequence(tags::POST_DEFORMATION_MATRIX_REGISTRATION_SEQUENCE, Vec::new()));
    });
    let [grid, _] = grids();
    let read = read_deformable(&path).unwrap().displacement;
    assert!(probes(&grid).iter().all(|x| (ours(&read, x) - ours(&wavy(&grid), x)).norm() < 1e-4));
    let refused = |change: &dyn Fn(&mut InMemDicomObject), word: &str| {
        changed(&path, change);
        let error = read_deformable(&path).unwrap_err().to_string();
        assert!(error.contains(word) && error.contains("REG.dcm"), "{error}");
    };
    let in_grid = |o: &mut InMemDicomObject, element: dicom_object::mem::InMemElement| {
        let tag = tags::DEFORMABLE_REGISTRATION_GRID_SEQUENCE;
        o.update_value(tag, |v| {
            v.items_mut().unwrap()[0].put(element.clone());
        });
    };
    let vectors =
        |values: Vec<f32>| DataElement::new(tags::VECTOR_GRID_DATA, VR::OF, PrimitiveValue::F32(values.into()));
    refused(&|o| in_grid(o, vectors(vec![0.0; 359])), "359 numbers");
    refused(
        &|o| {
            let mut values = vec![0.0; 360];
            values[30..33].fill(f32::NAN);
            in_grid(o, vectors(values));
        },
        "1 of its 120 vectors",
    );
    refused(&|o| in_grid(o, decimals(tags::IMAGE_ORIENTATION_PATIENT, [1.0, 0.0, 0.0, 0.5, 1.0, 0.0])), "sheared");
    refused(&|o| in_grid(o, decimals(tags::IMAGE_POSITION_PATIENT, [1.0, 0.0])), "not 3 finite numbers");
    let mut projective = Matrix4::identity();
    projective[(3, 2)] = 0.01;
    refused(&|o| drop(o.put(sequence(pre, vec![matrix_item(&projective)]))), "last row");
    refused(&|o| drop(o.put(sequence(tags::DEFORMABLE_REGISTRATION_GRID_SEQUENCE, Vec::new()))), "no deformation grid");
    // As one vendor writes it: the matrix in a registration of its own.
    changed(&path, |_| ());
    let mut object = open(&path);
    let beside = item([
        text(tags::SOURCE_FRAME_OF_REFERENCE_UID, VR::UI, "1.9.1"),
        sequence(pre, vec![matrix_item(&Matrix4::new_translation(&Vector3::x()))]),
    ]);
    object.update_value(tags::DEFORMABLE_REGISTRATION_SEQUENCE, |v| v.items_mut().unwrap().push(beside.clone()));
    object.write_to_file(&path).unwrap();
    assert!(read_deformable(&path).unwrap_err().to_string().contains("registration of its own"));
}

#[test]
fn fields_that_are_not_finite_are_not_written() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("REG.dcm");
    let [grid, _] = grids();
    let series = series_in("1.2.3.4", "planning", "1.9.1", &grid);
    let about = DerivedRegistration { role: "d", description: "d", number: 905, from: &series, to: &series };
    let mut field = wavy(&grid);
    field.data_mut()[7][1] = f32::NAN;
    assert!(write_deformable(&path, &field, &about, &origin()).unwrap_err().to_string().contains("[1, 1, 0]"));
}

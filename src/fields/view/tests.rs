use super::*;

const CENTRE: [f64; 2] = [52.0, 46.0];

/// Tissue of 20 HU with a texture, in a square of 100 mm and 20 slices of 3 mm.
fn grid() -> Grid {
    Grid::axis_aligned([50, 50, 20], [2.0, 2.0, 3.0], [-10.0, 5.0, 100.0]).unwrap()
}

fn tissue(l: usize) -> f32 {
    20.0 + (l * 7919 % 31) as f32
}

fn from_axis(l: usize) -> f64 {
    let [i, j, _] = grid().voxel(l);
    (2.0 * i as f64 - CENTRE[0]).hypot(2.0 * j as f64 - CENTRE[1])
}

fn round(radius: f64, padding: f32, rim: f64) -> Volume<f32> {
    Volume::from_fn(grid(), |l| {
        let far = from_axis(l);
        match far {
            _ if far > radius => padding,
            _ if far > radius - rim => tissue(l) + 300.0,
            _ => tissue(l),
        }
    })
}

#[test]
fn a_circle_is_found_with_any_padding() {
    for padding in [-1000.0, -1024.0, -3024.0, 0.0, -2000.0, f32::NAN] {
        let ct = round(40.0, padding, 0.0);
        let view = View::of(&ct);
        let circle = view.report.circle.unwrap_or_else(|| panic!("{padding}"));
        assert!((circle.radius_mm - 40.0).abs() < 1.0, "{padding} {circle:?}");
        assert!((circle.centre_mm[0] - CENTRE[0] + 10.0).abs() < 0.5, "{circle:?}");
        assert!((circle.centre_mm[1] - CENTRE[1] - 5.0).abs() < 0.5, "{circle:?}");
        assert!(same(view.report.padding.unwrap(), padding));
        let measured = view.measured().unwrap();
        for l in 0..grid().len() {
            let far = from_axis(l);
            assert!(!measured.data()[l] || far <= 37.5, "padding or its edge counts as measured: {far}");
            assert!(measured.data()[l] || far > 34.5, "{far} is not measured");
        }
    }
}

#[test]
fn the_report_tells_of_every_place_what_the_mask_tells_of_voxels() {
    let mut ct = round(40.0, -1000.0, 6.0);
    let plane = 2500;
    ct.data_mut()[..2 * plane].fill(-1000.0);
    let view = View::of(&ct);
    let (measured, grid) = (view.measured().unwrap(), grid());
    let (mut same, mut all) = (0, 0);
    for l in 0..grid.len() {
        let at = grid.voxel(l);
        let shows = view.report.shows(&grid, &grid.centre(at));
        // The mask also leaves out the voxels beside.
        assert!(shows || !measured.data()[l], "{at:?}");
        (same, all) = (same + usize::from(shows == measured.data()[l]), all + 1);
    }
    assert!(same * 20 > all * 18, "{same} of {all}");
    assert!(!view.report.shows(&grid, &Point3::new(CENTRE[0] - 10.0, CENTRE[1] + 5.0, 90.0)), "beyond the scan");
}

#[test]
fn a_bright_rim_is_no_measurement() {
    let view = View::of(&round(44.0, -1000.0, 7.0));
    let rim = view.report.circle.unwrap().rim_mm;
    assert!((7.0..=9.0).contains(&rim), "{rim}");
    assert!(View::of(&round(44.0, -1000.0, 0.0)).report.circle.unwrap().rim_mm.abs() < f64::EPSILON);
}

#[test]
fn blank_ends_and_padding_by_value_are_no_measurement() {
    let mut ct = Volume::from_fn(grid(), tissue);
    let plane = 2500;
    ct.data_mut()[..2 * plane].fill(-1000.0);
    ct.data_mut()[19 * plane..].fill(0.0);
    let view = View::of(&ct);
    assert_eq!(view.report.blank, [[0, 0], [0, 0], [2, 1]]);
    assert!((view.report.measured_percent - 75.0).abs() < 1e-9);
    assert_eq!(view.report.words(), ["3 blank slices at the edges"]);
    let side = ViewReport { blank: [[1, 0], [0, 0], [0, 0]], ..ViewReport::default() };
    assert_eq!(side.words(), ["1 blank column at the edge"], "a column is no slice");
    let all = ViewReport { blank: [[0, 0], [1, 2], [0, 1]], ..ViewReport::default() };
    assert_eq!(all.words(), ["1 blank slice at the edge", "3 blank rows at the edges"]);
    // A band along one side.
    let band = Volume::from_fn(grid(), |l| if grid().voxel(l)[0] < 12 { -2000.0 } else { tissue(l) });
    let view = View::of(&band);
    assert!(view.report.circle.is_none());
    assert!(!*view.measured().unwrap().at([12, 9, 9]) && *view.measured().unwrap().at([13, 9, 9]));
}

#[test]
fn air_around_a_patient_is_measured_though_it_is_cut_off_at_one_value() {
    // A patient as wide as 0.7 of his depth, in air of exactly one value.
    let ct = Volume::from_fn(grid(), |l| {
        let [i, j, _] = grid().voxel(l);
        let (x, y) = (2.0 * i as f64 - 50.0, 2.0 * j as f64 - 50.0);
        if (x / 44.0).powi(2) + (y / 31.0).powi(2) < 1.0 { tissue(l) } else { -1024.0 }
    });
    let view = View::of(&ct);
    assert_eq!(view.report, ViewReport { measured_percent: 100.0, ..ViewReport::default() });
    assert!(view.measured().is_none());
    assert!(matches!(view.known(&ct), Cow::Borrowed(_)));
}

#[test]
fn what_was_not_measured_is_no_number() {
    let ct = round(40.0, -1000.0, 0.0);
    let view = View::of(&ct);
    let known = view.known(&ct);
    let measured = view.measured().unwrap();
    assert!(known.data().iter().zip(measured.data()).all(|(v, m)| v.is_nan() != *m));
}

#[test]
fn air_cut_off_at_the_paddings_value_does_not_hide_the_circle() {
    // Half of the air voxels have the padding's value; the circle leaves blank columns beside it and is cut by one side.
    let ct = Volume::from_fn(grid(), |l| {
        let [i, j, _] = grid().voxel(l);
        let air = if l * 7919 % 97 < 48 { -1024.0 } else { -990.0 };
        match (2.0 * i as f64 - 40.0).hypot(2.0 * j as f64 - 50.0) {
            far if far > 44.0 => -1024.0,
            _ if (j as f64 - 25.0).abs() > 12.0 => air,
            _ => tissue(l),
        }
    });
    let report = View::of(&ct).report;
    let circle = report.circle.expect("the circle is found");
    assert!((circle.radius_mm - 44.0).abs() < 1.5, "{circle:?}");
    assert_eq!(report.blank, [[0; 2]; 3]);
}

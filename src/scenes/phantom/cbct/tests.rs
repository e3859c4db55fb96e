//! Each effect on a scene that shows it alone.

use super::super::shape::V3;
use super::*;
use crate::geometry::Grid;

/// HU of water with a ball of bone and air around, on an oblique or plain grid.
fn scene() -> Volume<f32> {
    let grid = Grid::axis_aligned([60, 56, 50], [5.0, 5.0, 4.0], [-150.0, -130.0, 20.0]).unwrap();
    let middle = grid.middle();
    Volume::from_fn(grid.clone(), |n| {
        let p = grid.centre(grid.voxel(n)) - middle;
        match (p.x.hypot(p.y), p.norm()) {
            (_, d) if d < 20.0 => 1000.0,
            (r, _) if r < 120.0 => 0.0,
            _ => -1000.0,
        }
    })
}

fn mean_and_sd(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (mean, (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt())
}

/// HU of voxels by their distance to the axis and height from the middle, mm.
fn where_<'a>(image: &'a Volume<f32>, wanted: impl Fn(f64, f64) -> bool + 'a) -> Vec<f64> {
    let grid = image.grid();
    let middle = grid.middle();
    let of = |n: &usize| {
        let p = grid.centre(grid.voxel(*n)) - middle;
        wanted(p.x.hypot(p.y), p.z)
    };
    (0..grid.len()).filter(of).map(|n| f64::from(image.data()[n])).collect()
}

#[test]
fn nothing_changes_without_effects() {
    assert_eq!(degrade(&scene(), &CbctOptions::off(), 3).unwrap(), scene());
}

#[test]
fn gain_is_about_air_and_noise_is_as_large_as_asked() {
    let options = CbctOptions { gain: 0.8, noise_hu: 60.0, ..CbctOptions::off() };
    let image = degrade(&scene(), &options, 3).unwrap();
    let (mean, sd) = mean_and_sd(&where_(&image, |r, z| r < 115.0 && z.abs() > 25.0));
    assert!((mean + 200.0).abs() < 1.0 && (sd - 60.0).abs() < 1.0, "{mean} {sd}");
    let bone = mean_and_sd(&where_(&image, |r, z| r.hypot(z) < 18.0)).0;
    assert!((bone - 600.0).abs() < 15.0, "{bone}");
    // What lies below the least that a scanner stores is cut off.
    let air = where_(&image, |r, _| r > 125.0);
    assert!(air.iter().all(|v| *v >= -1024.0) && (mean_and_sd(&air).0 + 1000.0).abs() < 25.0);
}

#[test]
fn cupping_is_deepest_on_the_axis_and_leaves_air() {
    let options = CbctOptions { cupping_hu: -180.0, cupping_radius_mm: 100.0, ..CbctOptions::off() };
    let image = degrade(&scene(), &options, 3).unwrap();
    let at = |from: f64, to: f64| mean_and_sd(&where_(&image, move |r, z| z > 25.0 && r >= from && r < to)).0;
    assert!((at(0.0, 5.0) + 180.0).abs() < 2.0, "{}", at(0.0, 5.0));
    assert!((at(68.0, 73.0) + 90.0).abs() < 4.0, "{}", at(68.0, 73.0));
    assert_eq!((at(101.0, 119.0), at(122.0, 130.0)), (0.0, -1000.0));
    let everywhere = CbctOptions { air_share: 1.0, cupping_hu: 50.0, cupping_radius_mm: 200.0, ..options };
    let image = degrade(&scene(), &everywhere, 3).unwrap();
    let air = mean_and_sd(&where_(&image, |r, _| (125.0..130.0).contains(&r))).0;
    assert!((air + 970.0).abs() < 2.0, "{air}");
}

#[test]
fn shading_is_slow_and_no_greater_than_asked() {
    let options = CbctOptions { shading_hu: 60.0, shading_mm: 150.0, ..CbctOptions::off() };
    let image = degrade(&scene(), &options, 5).unwrap();
    let water = where_(&image, |r, z| r < 118.0 && z.abs() > 22.0);
    let (low, high) = water.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
    assert!((-60.0..-40.0).contains(&low) && (40.0..=60.0).contains(&high), "{low} {high}");
    let (grid, strides) = (image.grid(), image.grid().strides());
    let inside = |p: &V3| p.x.hypot(p.y) < 119.0 && p.z.abs() > 24.0;
    for n in 0..grid.len() - strides[2] {
        let next = n + strides[2];
        let [a, b] = [n, next].map(|n| grid.centre(grid.voxel(n)) - grid.middle());
        if inside(&a) && inside(&b) && a.z * b.z > 0.0 {
            // 4 mm of waves of 150 mm.
            assert!((image.data()[n] - image.data()[next]).abs() < 12.0, "{a} {b}");
        }
    }
}

#[test]
fn outside_of_the_circle_and_in_blank_slices_lies_padding_alone() {
    let options = CbctOptions {
        circle_radius_mm: 90.0,
        circle_offset_mm: [20.0, -10.0],
        padding_hu: -2000.0,
        blank_slices: [2, 5],
        length_mm: 120.0,
        rim_hu: 300.0,
        rim_mm: 5.0,
        noise_hu: 30.0,
        ..CbctOptions::off()
    };
    let image = degrade(&scene(), &options, 3).unwrap();
    assert_eq!(image.grid().size(), [60, 56, 31]);
    assert!((image.grid().middle() - scene().grid().middle()).norm() < 4.0);
    let (grid, middle, seen) = (image.grid(), image.grid().middle(), options.measured(image.grid()));
    let (mut outside, mut rim, mut inner) = (0, Vec::new(), Vec::new());
    for n in 0..grid.len() {
        let (at, p) = (grid.voxel(n), grid.centre(grid.voxel(n)) - middle - V3::new(20.0, -10.0, 0.0));
        let (r, from_axis) = (p.x.hypot(p.y), (p + V3::new(20.0, -10.0, 0.0)).norm());
        let measured = r <= 90.0 && (2..26).contains(&at[2]);
        assert_eq!(image.data()[n] > -1100.0, measured, "{at:?}");
        assert_eq!(seen.data()[n], measured);
        outside += usize::from(!measured);
        if measured && from_axis > 25.0 && r > 85.0 {
            rim.push(f64::from(image.data()[n]));
        } else if measured && from_axis > 25.0 && r < 60.0 {
            inner.push(f64::from(image.data()[n]));
        }
    }
    let (rim, inner) = (mean_and_sd(&rim).0, mean_and_sd(&inner).0);
    // The mean of exp(-depth / 5 mm) over 5 mm is 0.63.
    assert!(outside > 10_000 && (rim - 190.0).abs() < 25.0 && inner.abs() < 2.0, "{outside} {rim} {inner}");
}

#[test]
fn slices_lie_across_the_body_however_they_are_stored() {
    let options = CbctOptions {
        length_mm: 100.0,
        blank_slices: [1, 3],
        circle_radius_mm: 80.0,
        cupping_hu: -150.0,
        ..CbctOptions::off()
    };
    let plain = degrade(&scene(), &options, 3).unwrap();
    // Stored from head to foot, slices first.
    let old = scene();
    let [ni, nj, nk] = old.grid().size();
    let d = old.grid().direction();
    let direction = nalgebra::Matrix3::from_columns(&[-d.column(2), d.column(0).into(), d.column(1).into()]);
    let (s, corner) = (old.grid().spacing(), old.grid().centre([0, 0, nk - 1]));
    let grid = Grid::new([nk, ni, nj], [s[2], s[0], s[1]], corner, direction).unwrap();
    let turned = Volume::from_fn(grid.clone(), |n| {
        let [k, i, j] = grid.voxel(n);
        *old.at([i, j, nk - 1 - k])
    });
    let turned = degrade(&turned, &options, 3).unwrap();
    for n in 0..plain.grid().len() {
        let x = plain.grid().centre(plain.grid().voxel(n));
        let at = turned.grid().index(&x).map(|c| c.round() as usize);
        assert_eq!(plain.data()[n].to_bits(), turned.at(at.into()).to_bits(), "{x}");
    }
}

#[test]
fn streaks_are_straight_and_within_slices() {
    let options = CbctOptions { streak_hu: 100.0, ..CbctOptions::off() };
    let image = degrade(&scene(), &options, 3).unwrap();
    let water = where_(&image, |r, z| r < 118.0 && z.abs() > 22.0);
    let touched = water.iter().filter(|v| v.abs() > 20.0).count() as f64 / water.len() as f64;
    assert!((0.01..0.4).contains(&touched), "{touched}");
    let (mean, most) = (mean_and_sd(&water).0, water.iter().fold(0.0f64, |m, v| m.max(v.abs())));
    assert!(mean.abs() < 5.0 && (50.0..400.0).contains(&most), "{mean} {most}");
}

#[test]
fn one_seed_gives_one_image_at_any_number_of_threads() {
    let make = |threads, seed, options: &CbctOptions| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| degrade(&scene(), options, seed).unwrap())
    };
    let all = CbctOptions::default();
    let one = make(1, 9, &all);
    assert_eq!(one, make(3, 9, &all));
    assert_ne!(one, make(1, 10, &all));
    // What is cut off changes nothing of what stays.
    let longer = make(
        1,
        9,
        &CbctOptions { length_mm: 0.0, blank_slices: [0; 2], ..CbctOptions { noise_hu: 20.0, ..CbctOptions::off() } },
    );
    let short = make(1, 9, &CbctOptions { length_mm: 100.0, noise_hu: 20.0, ..CbctOptions::off() });
    let first = short.grid().size()[2];
    let offset = (longer.grid().size()[2] - first) / 2;
    assert_eq!(short.at([7, 8, 3]).to_bits(), longer.at([7, 8, 3 + offset]).to_bits());
}

#[test]
fn settings_are_written_as_they_are_read_and_nonsense_is_refused() {
    let own = CbctOptions { circle_offset_mm: [3.0, -4.5], ..CbctOptions::default() };
    assert_eq!(CbctOptions::parse(&own.to_toml().unwrap()).unwrap(), own);
    assert_eq!(
        CbctOptions::parse("noise_hu = 20.0").unwrap(),
        CbctOptions { noise_hu: 20.0, ..CbctOptions::default() }
    );
    assert!(CbctOptions::parse("circle = 3").is_err());
    let refused = |options| degrade(&scene(), &options, 1).unwrap_err().to_string();
    assert!(refused(CbctOptions { gain: f64::NAN, ..CbctOptions::default() }).contains("gain"));
    assert!(refused(CbctOptions { noise_hu: -1.0, ..CbctOptions::default() }).contains("noise"));
    assert!(refused(CbctOptions { blank_slices: [30, 30], ..CbctOptions::default() }).contains("blank"));
}

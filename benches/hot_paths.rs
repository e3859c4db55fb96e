//! Hot paths of a registration on the phantom, each over a range of sizes: `cargo bench`.

use aventail::chainmail::{
    ChainmailOptions, Combination, Initiators, Lattice, Material, Organs, Tissue, Variant, propagate, spread,
};
use aventail::field::{
    Chain, FieldFormat, Interpolation, InvertOptions, Link, Motion, PushField, invert, jacobian, resample, warp_image,
};
use aventail::fit::{BoneSamples, FitOptions, FitStart, fit_pose};
use aventail::geometry::Grid;
use aventail::io::{self, Stored, WriteOptions};
use aventail::phantom::{Phantom, PhantomOptions};
use aventail::progress::Silent;
use aventail::volume::{Volume, gaussian};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::Point3;

/// The phantom at a spacing, with its true field.
fn phantom(spacing: [f64; 3]) -> (Phantom, PushField) {
    let base = PhantomOptions::default();
    let size = std::array::from_fn(|a| (base.size[a] as f64 * base.spacing_mm[a] / spacing[a]) as usize);
    let phantom = Phantom::new(&PhantomOptions { size, spacing_mm: spacing, ..base }).expect("a legal phantom");
    let truth = phantom.truth().expect("a legal field");
    (phantom, truth)
}

/// Fields and images: by the number of voxels.
fn fields(c: &mut Criterion) {
    let mut group = c.benchmark_group("field");
    group.sample_size(10);
    for spacing in [[4.0, 4.0, 6.0], [2.0, 2.0, 3.0]] {
        let (phantom, truth) = phantom(spacing);
        let voxels = phantom.planning.grid().len();
        group.throughput(Throughput::Elements(voxels as u64));
        let grid = phantom.fraction.grid();
        let (pull, _) = invert(&truth, grid, None, &InvertOptions::default()).expect("grids agree");
        group.bench_with_input(BenchmarkId::new("jacobian", voxels), &truth, |b, f| b.iter(|| jacobian(f)));
        group.bench_with_input(BenchmarkId::new("invert to 1e-3 mm", voxels), &truth, |b, f| {
            b.iter(|| invert(f, grid, None, &InvertOptions::default()));
        });
        group.bench_with_input(BenchmarkId::new("resample", voxels), &pull, |b, f| {
            b.iter(|| warp_image(f, &phantom.planning, -1000.0));
        });
        group.bench_with_input(BenchmarkId::new("blur 2 mm", voxels), &phantom.planning, |b, v| {
            b.iter(|| gaussian(v, 2.0));
        });
    }
    group.finish();
}

/// The inverse: by its tolerance.
fn inverse(c: &mut Criterion) {
    let (phantom, truth) = phantom([3.0, 3.0, 3.0]);
    let grid = phantom.fraction.grid();
    let mut group = c.benchmark_group("invert");
    group.sample_size(10);
    group.throughput(Throughput::Elements(grid.len() as u64));
    for tolerance_mm in [1e-1, 1e-2, 1e-3] {
        let options = InvertOptions { tolerance_mm, ..InvertOptions::default() };
        group.bench_with_input(BenchmarkId::new("tolerance mm", tolerance_mm), &options, |b, o| {
            b.iter(|| invert(&truth, grid, None, o));
        });
    }
    group.finish();
}

/// Waves at every voxel: by the number of bones, one from all and one from each.
fn waves(c: &mut Criterion) {
    let (phantom, _) = phantom([3.0, 3.0, 3.0]);
    let all: Vec<Option<u16>> = {
        let mut table = vec![None; usize::from(u16::MAX) + 1];
        let bones = phantom.skeleton.bones.iter().enumerate();
        bones.for_each(|(b, bone)| table[usize::from(bone.label)] = Some(b as u16));
        table
    };
    let centroids: Vec<Point3<f64>> = phantom.skeleton.bones.iter().map(|b| b.centroid).collect();
    let mut group = c.benchmark_group("waves");
    group.sample_size(10);
    for bones in [5, 10, 20, 42] {
        let bone_of_label: Vec<Option<u16>> = all.iter().map(|b| b.filter(|b| usize::from(*b) < bones)).collect();
        let tissue = Tissue {
            ct: &phantom.planning,
            body: &phantom.body,
            labels: &phantom.bones,
            bone_of_label: &bone_of_label,
            lung: None,
            sliding: None,
            least_hu: -500.0,
        };
        let moved = Initiators { transforms: &phantom.transforms[..bones], centroids: &centroids[..bones] };
        let lattice = Lattice::new(&tissue, &Material::default(), &Organs::default(), 0.0);
        group.throughput(Throughput::Elements(lattice.active.len() as u64));
        for (name, combination) in
            [("from all bones", Combination::Prioritisation), ("of each bone", Combination::Superposition)]
        {
            let variant = Variant { combination, prune_ratio: 0.0, ..Variant::default() };
            group.bench_with_input(BenchmarkId::new(name, bones), &variant, |b, v| {
                b.iter(|| spread(&lattice, &moved, v));
            });
        }
    }
    group.finish();
}

/// Files: by the gzip level.
fn files(c: &mut Criterion) {
    let (phantom, truth) = phantom([3.0, 3.0, 3.0]);
    let folder = tempfile::tempdir().expect("a folder");
    let mut group = c.benchmark_group("files");
    group.sample_size(10);
    for gzip_level in [0, 2, 6] {
        let path = folder.path().join(format!("{gzip_level}.nii.gz"));
        let options = WriteOptions { gzip_level, ..WriteOptions::default() };
        io::write_image(&path, &phantom.planning, Stored::Int16, &options).expect("it is written");
        group.bench_with_input(BenchmarkId::new("read CT, level", gzip_level), &path, |b, p| {
            b.iter(|| io::read_image(p));
        });
        let field = folder.path().join(format!("field{gzip_level}.nii.gz"));
        group.bench_with_input(BenchmarkId::new("write field, level", gzip_level), &field, |b, p| {
            b.iter(|| io::write_push(p, &truth, FieldFormat::Nifti, gzip_level));
        });
    }
    group.finish();
}

/// Propagation: by the spacing of the elements, with and without relaxation and pruning.
fn propagation(c: &mut Criterion) {
    let (phantom, _) = phantom([2.0, 2.0, 3.0]);
    let mut bone_of_label = vec![None; usize::from(u16::MAX) + 1];
    phantom.skeleton.bones.iter().enumerate().for_each(|(b, bone)| {
        bone_of_label[usize::from(bone.label)] = Some(b as u16);
    });
    let centroids: Vec<Point3<f64>> = phantom.skeleton.bones.iter().map(|b| b.centroid).collect();
    let tissue = Tissue {
        ct: &phantom.planning,
        body: &phantom.body,
        labels: &phantom.bones,
        bone_of_label: &bone_of_label,
        lung: None,
        sliding: None,
        least_hu: -500.0,
    };
    let bones = Initiators { transforms: &phantom.transforms, centroids: &centroids };
    let mut group = c.benchmark_group("propagate");
    group.sample_size(10);
    for (name, prune_ratio, relaxed) in
        [("exact", 0.0, false), ("pruned", 16.0, false), ("pruned, relaxed", 16.0, true)]
    {
        for spacing_mm in [6.0, 4.0, 3.0] {
            let relaxation = if relaxed { [(12.0, 40), (spacing_mm, 20)].map(Into::into).into() } else { Vec::new() };
            let variant = Variant { prune_ratio, ..Variant::default() };
            let options = ChainmailOptions { spacing_mm, relaxation, variant, ..ChainmailOptions::default() };
            group.bench_with_input(BenchmarkId::new(name, spacing_mm), &options, |b, o| {
                b.iter(|| propagate(&tissue, &bones, o, None, &Silent));
            });
        }
    }
    group.finish();
}

/// The fit: by samples per bone at the finest level.
fn fit(c: &mut Criterion) {
    let (phantom, _) = phantom([3.0, 3.0, 3.0]);
    let mut group = c.benchmark_group("fit");
    group.sample_size(10);
    for samples in [1000, 4000, 12_000] {
        let options = FitOptions { levels: vec![(0.8, samples).into()], ..FitOptions::default() };
        group.bench_with_input(BenchmarkId::new("42 bones", samples), &options, |b, o| {
            b.iter(|| {
                let samples = BoneSamples::new(&phantom.skeleton, &phantom.planning, &phantom.bones, o);
                fit_pose(&phantom.skeleton, &samples, &phantom.fraction, FitStart::Search, o, &Silent)
            });
        });
    }
    group.finish();
}

/// A dose of 512 x 512 x 126 voxels through a pull field on the same grid, and through one of another grid.
fn dose(c: &mut Criterion) {
    let grid = |size: [usize; 3], spacing| Grid::axis_aligned(size, spacing, [-250.0, -250.0, -180.0]).expect("a grid");
    let fine = grid([512, 512, 126], [0.98, 0.98, 3.0]);
    let wave = |grid: &Grid| {
        Volume::from_fn(grid.clone(), |n| {
            let p = grid.centre(grid.voxel(n));
            [8.0 * (p.y / 40.0).sin() as f32, 6.0 * (p.z / 50.0).cos() as f32, 5.0 * (p.x / 45.0).sin() as f32]
        })
    };
    let planned = Volume::from_fn(grid([170, 170, 126], [2.95, 2.95, 3.0]), |n| (n % 977) as f32 / 14.0);
    let same = Volume::from_fn(fine.clone(), |n| (n % 977) as f32 / 14.0);
    let v = wave(&fine);
    let mut group = c.benchmark_group("warp");
    group.sample_size(10);
    group.throughput(Throughput::Elements(fine.len() as u64));
    for (name, dose) in [("dose, same grid", &same), ("dose, 3 mm grid", &planned)] {
        group.bench_function(name, |b| b.iter(|| resample(&v, dose, Interpolation::Linear, 0.0)));
    }
    group.bench_function("dose, cubic", |b| b.iter(|| resample(&v, &same, Interpolation::Cubic, 0.0)));
    let coarse = wave(&grid([170, 170, 126], [2.95, 2.95, 3.0]));
    let motion = Motion::Field(Box::new(coarse));
    let links = [Link { name: "coarse".into(), from: "b".into(), to: "a".into(), motion }];
    let chain = Chain::between(&links, "b", "a", &InvertOptions::default()).expect("it is one link");
    group.bench_function("field of another grid", |b| b.iter(|| chain.displacement_on(&fine)));
    group.finish();
}

criterion_group!(benches, fields, inverse, dose, waves, propagation, fit, files);
criterion_main!(benches);

use std::cell::RefCell;
use std::path::Path;

use super::*;
use crate::cluster::comm::memory;
use crate::cluster::{Comm, Solo};
use crate::image::Image;
use crate::job::thread_pool;
use crate::output::progress::ProgressKind;
use crate::output::timeline::Timeline;
use crate::output::write::{Format, WriteOptions, encode};
use crate::scene::load;
use crate::settings::{BuildPreset, Encoding};
use reference::fingerprint;

fn curve(sampler: SamplerKind, adaptive: bool) -> Curve {
    Curve {
        sampler,
        filter: Filter::Box,
        direct: Direct::Both,
        accel: AccelKind::Bvh,
        precision: Precision::Exact,
        adaptive,
    }
}

/// The Cornell box in 16 x 12 pixels.
fn subject(folder: Option<&Path>) -> Subject {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell-path.toml");
    let scene = load::load(&path).unwrap().scene;
    let accels =
        [AccelKind::Bvh, AccelKind::Grid].map(|kind| Accel::build(kind, BuildPreset::Fast, &scene.surfaces));
    let integrator = Integrator::Path;
    let image =
        ImageSettings { integrator, max_depth: integrator.max_depth(), ..ImageSettings::sized(16, 12) };
    let cache = folder.map(|folder| Cache {
        folder: folder.into(),
        name: "box".into(),
        scene: fingerprint(&scene).unwrap(),
    });
    Subject { name: "box".into(), scene, accels: accels.into(), image, cache }
}

fn plan(curves: Vec<Curve>, spp: &[u32], reference: u32) -> Plan {
    Plan {
        curves,
        spp: spp.to_vec(),
        targets: vec![0.2, 0.05],
        rounds: 1,
        seeds: 1,
        limit: 1e9,
        reference: Quality::Samples(reference),
    }
}

/// Measures on this rank; also what was told.
fn run(comm: &dyn Comm, subject: Option<Subject>, plan: &Plan) -> (Option<Measured>, Vec<String>) {
    let pool = thread_pool(2).unwrap();
    let (timeline, progress) = (&Timeline::off(), ProgressKind::None.start());
    let crew = Crew { comm, pool: &pool, wide: &pool, timeline, progress: &*progress };
    let told = RefCell::new(Vec::new());
    let tell = |what: &str| told.borrow_mut().push(what.to_string());
    let measured = measure(&crew, subject.map(|subject| (subject, plan)), &tell).unwrap();
    (measured, told.into_inner())
}

fn alone(subject: Subject, plan: &Plan) -> (Measured, Vec<String>) {
    let (measured, told) = run(&Solo::new(), Some(subject), plan);
    (measured.unwrap(), told)
}

#[test]
fn independent_samples_converge_by_their_root() {
    let curves = vec![curve(SamplerKind::Independent, false), curve(SamplerKind::Sobol, false)];
    // Few pixels see the lamp's edge, and most of the error is theirs: it takes many seeds.
    let plan = Plan { seeds: 24, ..plan(curves, &[1, 2, 8, 32], 2048) };
    let (measured, _) = alone(subject(None), &plan);
    assert_eq!((measured.width, measured.height, measured.threads), (16, 12, 2));
    let [independent, sobol] = &measured.curves[..] else { panic!("two curves") };
    let slope = independent.slope.unwrap();
    assert!((-0.6..=-0.4).contains(&slope), "{slope}");
    assert!(sobol.slope.unwrap() < slope, "{:?}", sobol.slope);
    assert_eq!(independent.rungs.iter().map(|rung| rung.mean_spp).collect::<Vec<_>>(), [1.0, 2.0, 8.0, 32.0]);
    let reference = &measured.references[0];
    for rung in independent.rungs.iter().chain(&sobol.rungs) {
        assert!(!rung.near_reference && rung.rays > 192.0 * rung.mean_spp);
        let squares = rung.measured_rmse * rung.measured_rmse - reference.rmse * reference.rmse;
        assert!((squares.sqrt() / rung.rmse - 1.0).abs() < 1e-9);
        assert!((rung.efficiency * rung.rmse * rung.rmse * rung.seconds - 1.0).abs() < 1e-9);
        assert!(rung.core_seconds == 2.0 * rung.seconds && rung.seconds >= rung.trace_seconds);
    }
    assert!(measured.curves.iter().any(|curve| curve.rungs.iter().any(|rung| rung.on_front)));
}

/// The spread of the reference's parts says of it what other images find.
#[test]
fn the_references_error_is_what_it_says() {
    let only = vec![curve(SamplerKind::Sobol, false)];
    let (found, _) = alone(subject(None), &Plan { seeds: 8, ..plan(only, &[64], 256) });
    let (rung, reference) = (&found.curves[0].rungs[0], &found.references[0]);
    // A reference of 4 parts of 64 samples has a quarter of the mean square error of one.
    let expected = rung.rmse * rung.rmse / 4.0;
    let told = reference.rmse * reference.rmse;
    assert!((told / expected - 1.0).abs() < 0.25, "{told} instead of {expected}");
}

#[test]
fn a_reference_that_is_no_better_is_told() {
    let (measured, _) =
        alone(subject(None), &plan(vec![curve(SamplerKind::Sobol, false)], &[4, 64, 256], 64));
    let rungs = &measured.curves[0].rungs;
    assert!(!rungs[0].near_reference && rungs[2].near_reference);
    assert_eq!(rungs[2].rmse, rungs[2].measured_rmse);
}

#[test]
fn adaptive_curves_reach_what_they_were_asked_for() {
    let (measured, _) = alone(subject(None), &plan(vec![curve(SamplerKind::Sobol, true)], &[], 1024));
    let rungs = &measured.curves[0].rungs;
    assert_eq!(rungs.len(), 2);
    for (rung, target) in rungs.iter().zip([0.2, 0.05]) {
        assert_eq!(rung.effort, Effort::Target(target));
        assert!(
            rung.told_rmse.unwrap() <= target && rung.told_rmse_at_most.unwrap() > rung.told_rmse.unwrap()
        );
        assert!(rung.rmse < 1.3 * target, "{} of {target}", rung.rmse);
    }
    assert!(rungs[0].mean_spp >= 16.0 && rungs[1].mean_spp > rungs[0].mean_spp);
}

/// On so wide a floor the ε of f32 is a fifth of the wall's height, and light comes through where the two meet. In f64 it is too small to be seen.
#[test]
fn samples_do_not_mend_what_precision_spoils() {
    let text = "
[camera]
position = [0, 1, 3]
look_at = [0.3, 0, 0]
fov = 30
[[material]]
name = \"matt\"
kd = 0.8
[[light]]
type = \"directional\"
direction = [0.2, -1, 1]
color = 0.9
[[object]]
type = \"plane\"
size = 4000
material = \"matt\"
[[object]]
type = \"plane\"
size = [2, 1]
rotate = [90, 0, 0]
translate = [0, 0.5, 0]
material = \"matt\"
";
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("wall.toml");
    std::fs::write(&path, text).unwrap();
    let scene = load::load(&path).unwrap().scene;
    let accels = vec![Accel::build(AccelKind::Grid, BuildPreset::Fast, &scene.surfaces)];
    let subject =
        Subject { name: "wall".into(), scene, accels, image: ImageSettings::sized(16, 16), cache: None };
    let of = |precision| Curve { accel: AccelKind::Grid, precision, ..curve(SamplerKind::Sobol, false) };
    let all = [Precision::Exact, Precision::F32, Precision::F64];
    let (measured, _) = alone(subject, &plan(all.map(of).into(), &[4, 64], 1024));
    let [exact, single, double] = [0, 1, 2].map(|k| &measured.curves[k].rungs[1]);
    assert!(single.rmse > 5.0 * exact.rmse, "{} {}", single.rmse, exact.rmse);
    assert!((double.measured_rmse / exact.measured_rmse - 1.0).abs() < 1e-3, "{double:?} {exact:?}");
    assert!(measured.curves.iter().all(|curve| curve.rungs[0].rmse > exact.rmse));
    assert!(single.rays > 0.9 * exact.rays);
}

#[test]
fn what_takes_too_long_is_left_out() {
    let plan = Plan { limit: 1e-9, ..plan(vec![curve(SamplerKind::Sobol, false)], &[2, 4, 8], 16) };
    let measured = alone(subject(None), &plan).0;
    assert_eq!(measured.curves[0].rungs.len(), 1);
    assert_eq!(measured.curves[0].left_out, [Effort::Spp(4), Effort::Spp(8)]);
}

#[test]
fn references_are_kept_and_damaged_ones_made_anew() {
    let folder = tempfile::tempdir().unwrap();
    let kept = || {
        let entries = std::fs::read_dir(folder.path()).unwrap();
        entries.map(|entry| entry.unwrap().path()).collect::<Vec<_>>()
    };
    let plan = plan(vec![curve(SamplerKind::Sobol, false)], &[4], 64);
    let (first, told) = alone(subject(Some(folder.path())), &plan);
    assert!(first.references[0].seconds.is_some());
    assert!(told.len() == 1 && told[0].contains("64 samples"), "{told:?}");
    let files = kept();
    assert_eq!((files.len(), Some(&files[0])), (1, first.references[0].file.as_ref()));
    let bytes = std::fs::read(&files[0]).unwrap();
    let written = std::fs::metadata(&files[0]).unwrap().modified().unwrap();

    let (again, told) = alone(subject(Some(folder.path())), &plan);
    assert!(told.is_empty() && again.references[0].seconds.is_none());
    assert_eq!(again.references[0].rmse, first.references[0].rmse);
    assert_eq!(again.curves[0].rungs[0].rmse, first.curves[0].rungs[0].rmse);
    assert_eq!(std::fs::metadata(&files[0]).unwrap().modified().unwrap(), written);

    // Another scene and other settings have files of their own; where time decides the best one is taken.
    let mut other = subject(Some(folder.path()));
    other.scene.header.background = [0.1; 3];
    other.cache.as_mut().unwrap().scene = fingerprint(&other.scene).unwrap();
    alone(other, &plan);
    let mut other = subject(Some(folder.path()));
    other.image.max_depth = 3;
    alone(other, &plan);
    assert_eq!(kept().len(), 3);
    let timed = Plan { reference: Quality::Seconds(1e-9), ..plan.clone() };
    assert_eq!(alone(subject(Some(folder.path())), &timed).0.references[0].seconds, None);

    let mut flipped = bytes.clone();
    let middle = flipped.len() / 2;
    flipped[middle] ^= 0x10;
    let options = WriteOptions { encoding: Encoding::Linear, metadata: Vec::new() };
    let small = encode(&Image::new(3, 2), Format::Exr, &options).unwrap();
    let bare = encode(&Image::new(16, 12), Format::Exr, &options).unwrap();
    for damaged in [&bytes[..bytes.len() / 2], &flipped, b"no image", &small, &bare] {
        std::fs::write(&files[0], damaged).unwrap();
        let (mended, told) = alone(subject(Some(folder.path())), &plan);
        assert!(told.len() == 2 && told[0].contains("made anew"), "{told:?}");
        assert_eq!(mended.references[0].rmse, first.references[0].rmse);
        assert!(std::fs::read(&files[0]).unwrap() == bytes);
    }
    assert_eq!(kept().len(), 3);
}

#[test]
fn ranks_render_what_rank_0_says_and_all_leave_together() {
    let curves = vec![
        curve(SamplerKind::Stratified, false),
        Curve { accel: AccelKind::Grid, ..curve(SamplerKind::Stratified, false) },
        curve(SamplerKind::Sobol, true),
    ];
    let plan = &Plan { seeds: 2, ..plan(curves, &[2, 8], 64) };
    let errors = |measured: &Measured| -> Vec<(f64, f64, f64)> {
        let rungs = measured.curves.iter().flat_map(|curve| &curve.rungs);
        rungs.map(|rung| (rung.rmse, rung.flip, rung.mean_spp)).collect()
    };
    let (expected, _) = alone(subject(None), plan);
    assert_eq!(expected.curves[0].rungs[1].rmse, expected.curves[1].rungs[1].rmse);
    let found: Vec<Option<Measured>> = std::thread::scope(|scope| {
        let start = |comm: memory::MemoryComm| {
            scope.spawn(move || run(&comm, (comm.rank() == 0).then(|| subject(None)), plan).0)
        };
        let ranks: Vec<_> = memory::group(3).into_iter().map(start).collect();
        ranks.into_iter().map(|rank| rank.join().unwrap()).collect()
    });
    assert!(found[1].is_none() && found[2].is_none());
    let found = found[0].as_ref().unwrap();
    assert_eq!((errors(found), found.threads), (errors(&expected), 6));
}

/// An error of rank 0 between renders, here a folder that isn't there, is everybody's.
#[test]
fn an_error_ends_all_ranks() {
    let plan = &plan(vec![curve(SamplerKind::Sobol, false)], &[2], 16);
    let errors: Vec<String> = std::thread::scope(|scope| {
        let start = |comm: memory::MemoryComm| {
            scope.spawn(move || {
                let pool = thread_pool(1).unwrap();
                let (timeline, progress) = (&Timeline::off(), ProgressKind::None.start());
                let crew = Crew { comm: &comm, pool: &pool, wide: &pool, timeline, progress: &*progress };
                let given = (comm.rank() == 0).then(|| (subject(Some("/no/such/folder".as_ref())), plan));
                measure(&crew, given, &|_| ()).unwrap_err().to_string()
            })
        };
        let ranks: Vec<_> = memory::group(2).into_iter().map(start).collect();
        ranks.into_iter().map(|rank| rank.join().unwrap()).collect()
    });
    assert!(errors[0].contains("/no/such/folder") && errors[0] == errors[1], "{errors:?}");
}

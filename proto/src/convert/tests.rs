//! What is refused, and that what is sent comes back.

use super::*;
use crate::types::{Aim, Heartbeat, JobSpec, JobState, LeaseRequest, Progress, ResultHeader, WorkerInfo};
use crate::{sums, types};
use proptest::prelude::*;
use std::time::Duration;
use tilecast_core::film::file::Target;
use tilecast_core::film::{self, TileSums};
use tilecast_core::settings::{
    Film, Filter, Half, Integrator, IntegratorKind, Offsets, SamplerKind, Strategy, Without,
};

fn settings() -> Settings {
    Settings {
        film: Film {
            width: 300,
            height: 200,
            crop: Window { x0: 10, y0: 20, x1: 110, y1: 90 },
            filter: Filter::Gaussian { stddev: 0.5 },
        },
        spp: 7,
        seed: u64::MAX,
        integrator: Integrator { kind: IntegratorKind::Whitted, max_depth: None, rr_depth: 5, hide_emitters: true },
        strategy: Strategy::Mis,
        sampler: SamplerKind::Sobol,
        half: Half::Second,
        offsets: Offsets::Mitsuba,
        without: Without {
            splitting: true,
            early_roulette: false,
            blind_ends: true,
            path_reuse: true,
            environment_cosine: true,
        },
        scale_exponent: -3,
    }
}

fn hello() -> wire::Hello {
    let name = || "x".to_owned();
    WorkerInfo { threads: 2, isa: name(), host: name(), pid: 1, name: name(), cpu: name(), instance: 1 }.into()
}

fn unit() -> wire::Unit {
    wire::Unit { job: 3, tile: Some(Window { x0: 0, y0: 0, x1: 2, y1: 1 }.into()), sample_start: 4, sample_end: 8 }
}

#[test]
fn settings_come_back_as_they_went() {
    let bells = [Filter::Box, Filter::Tent { radius: 1.5 }, Filter::Gaussian { stddev: 0.5 }];
    let with_lobes = [Filter::Mitchell { b: 0.2, c: 0.4 }, Filter::CatmullRom, Filter::Lanczos { lobes: 3.0 }];
    for filter in bells.into_iter().chain(with_lobes) {
        for max_depth in [None, Some(1), Some(u32::MAX)] {
            let mut there = settings();
            there.film.filter = filter;
            there.integrator.max_depth = max_depth;
            assert_eq!(Settings::try_from(wire::Settings::from(&there)), Ok(there));
        }
    }
}

#[test]
fn settings_that_break_a_rule_are_refused() {
    let refused = |spoil: fn(&mut wire::Settings)| {
        let mut message = wire::Settings::from(&settings());
        spoil(&mut message);
        Settings::try_from(message).unwrap_err()
    };
    assert_eq!(refused(|s| s.filter = None), WireError::Missing("settings.filter"));
    assert_eq!(refused(|s| s.integrator = None), WireError::Missing("settings.integrator"));
    assert_eq!(refused(|s| s.crop = None), WireError::Missing("settings.crop"));
    assert_eq!(refused(|s| s.strategy = 0), WireError::Enum { field: "settings.strategy", value: 0 });
    assert_eq!(refused(|s| s.sampler = 77), WireError::Enum { field: "settings.sampler", value: 77 });
    assert_eq!(refused(|s| s.spp = 0), WireError::Settings(SettingsError::NoSamples));
    let nan = |s: &mut wire::Settings| {
        s.filter = Some(wire::Filter { kind: Some(wire::filter::Kind::Tent(wire::TentFilter { radius: f32::NAN })) });
    };
    assert!(matches!(refused(nan), WireError::Settings(SettingsError::FilterRadius(_))));
    // A crop inside out would overflow its own width.
    let inside_out = |s: &mut wire::Settings| s.crop = Some(wire::Window { x0: 9, y0: 0, x1: 3, y1: 5 });
    assert!(matches!(refused(inside_out), WireError::Window { field: "settings.crop", .. }));
    assert!(matches!(refused(|s| s.width = 1 << 20), WireError::Settings(SettingsError::FilmSize(..))));
}

#[test]
fn a_worker_of_another_version_is_refused() {
    assert!(WorkerInfo::try_from(hello()).is_ok());
    let version = |protocol: u32, engine: &str| Some(wire::Version { protocol, engine: engine.to_owned() });
    for other in [version(99, tilecast_core::VERSION), version(crate::version::PROTOCOL, "0.0.0-other")] {
        let refusal = WorkerInfo::try_from(wire::Hello { version: other, ..hello() }).unwrap_err();
        assert!(matches!(refusal, WireError::Version(_)));
        assert_eq!(tonic::Status::from(refusal).code(), tonic::Code::FailedPrecondition);
    }
    assert_eq!(WorkerInfo::try_from(wire::Hello { version: None, ..hello() }), Err(WireError::Missing("version")));
}

#[test]
fn hostile_sizes_are_refused() {
    assert!(WorkerInfo::try_from(wire::Hello { threads: 0, ..hello() }).is_err());
    assert!(WorkerInfo::try_from(wire::Hello { host: "h".repeat(257), ..hello() }).is_err());
    assert!(types::Unit::try_from(unit()).is_ok());
    assert!(types::Unit::try_from(wire::Unit { sample_end: 4, ..unit() }).is_err());
    assert!(types::Unit::try_from(wire::Unit { sample_start: u32::MAX, ..unit() }).is_err());
    let large = Window { x0: 0, y0: 0, x1: 257, y1: 1 };
    assert!(types::Unit::try_from(wire::Unit { tile: Some(large.into()), ..unit() }).is_err());
    let wire = wire::LeaseRequest { worker: 1, slots: 0, known_jobs: vec![] };
    assert!(LeaseRequest::try_from(wire).is_err());
    let wire = wire::HeartbeatRequest { worker: 1, fences: vec![0; crate::limits::LEASES_HELD_MAX + 1], samples: 0 };
    assert!(Heartbeat::try_from(wire).is_err());
    assert_eq!(digest(&[0; 31], "d"), Err(WireError::Digest { field: "d", len: 31 }));
    assert!(blob_len(u64::MAX).is_err());
    let mut huge = settings();
    huge.film =
        Film { width: 1 << 16, height: 1 << 16, crop: Window { x0: 0, y0: 0, x1: 1 << 16, y1: 1 << 16 }, ..huge.film };
    let ranged = |settings: &Settings, starts: &[u32], ends: &[u32]| {
        JobSpec::try_from(wire::Job {
            sample_starts: starts.to_vec(),
            sample_ends: ends.to_vec(),
            scene: digest_bytes(&Digest([1; 32])),
            settings: Some(settings.into()),
            tile: 0,
            name: String::new(),
            workers_hold_scene: false,
            aim: None,
            ticket: 7,
            workers_max: 3,
        })
    };
    let job = |settings: &Settings| ranged(settings, &[0], &[settings.spp]);
    let accepted = job(&settings()).unwrap();
    assert_eq!((accepted.ticket, accepted.workers_max.unwrap().get()), (7, 3));
    assert_eq!(JobSpec::try_from(wire::Job::from(accepted.clone())), Ok(accepted));
    let spp = settings().spp;
    for (starts, ends) in [(&[][..], &[][..]), (&[0], &[0]), (&[0], &[spp + 1]), (&[2], &[1]), (&[0, 0], &[1])] {
        assert!(ranged(&settings(), starts, ends).is_err(), "{starts:?} {ends:?}");
    }
    assert_eq!(ranged(&settings(), &[0, 1], &[0, spp]).unwrap().samples, [0..0, 1..spp]);
    assert!(matches!(job(&huge), Err(WireError::Range { .. })));
    let aim = wire::Aim { error: 0.02, pixels: true, pilot: true, before: 9, image: 4, expected: 100 };
    let known = Aim::try_from(aim).unwrap();
    assert_eq!((known.target, wire::Aim::from(known)), (Some(Target::Pixels(0.02)), aim));
    for wrong in [
        wire::Aim { error: f32::NAN, ..aim },
        wire::Aim { error: -0.1, ..aim },
        wire::Aim { image: 10, ..aim },
        wire::Aim { expected: u64::MAX, ..aim },
    ] {
        assert!(Aim::try_from(wrong).is_err(), "{wrong:?}");
    }
}

#[test]
fn a_result_is_checked_against_its_unit() {
    let header = |bytes: u64| wire::ResultHeader {
        worker: 1,
        fence: 2,
        unit: Some(unit()),
        key: digest_bytes(&Digest([7; 32])),
        trace_us: 5,
        bytes,
        waited_us: 6,
    };
    assert!(ResultHeader::try_from(header(1 << 30)).is_err());
    let wire = header(24);
    let header = ResultHeader::try_from(wire.clone()).unwrap();
    assert_eq!(wire::ResultHeader::from(header.clone()), wire);
    let mut tile = TileSums::new(header.unit.tile, header.unit.samples.clone());
    assert_eq!(header.sums(&sums::encode(&tile.pixels)), Ok(tile.clone()));
    tile.pixels[1].0[2][1] = i128::MAX;
    assert_eq!(header.sums(&sums::encode(&tile.pixels)), Err(WireError::Unbounded));
    assert!(matches!(header.sums(&[0; 3]), Err(WireError::Sums(_))));
}

#[test]
fn the_key_sees_scene_and_settings() {
    let (scene, other) = (Digest([1; 32]), Digest([2; 32]));
    let key = work_key(&scene, &settings());
    assert_eq!(key, work_key(&scene, &settings()));
    assert_ne!(key, work_key(&other, &settings()));
    assert_ne!(key, work_key(&scene, &Settings { seed: 1, ..settings() }));
}

#[test]
fn progress_comes_back_as_it_went() {
    for state in [JobState::Queued, JobState::Failed("why".into()), JobState::Finished] {
        let progress = Progress {
            job: JobId(4),
            name: "n".into(),
            state,
            samples_done: 5,
            samples_found: 3,
            samples_total: 6,
            workers: 1,
            samples_per_second: 1.5,
            relative_error: Some(film::RelativeError { value: 0.25, low: 0.2, high: 0.3 }),
            elapsed: Duration::from_millis(7),
            running: Duration::from_millis(6),
            merging: Duration::from_micros(7),
            scene: Digest([3; 32]),
            settings: settings(),
        };
        assert_eq!(Progress::try_from(wire::Progress::from(progress.clone())), Ok(progress));
    }
}

fn filled_film() -> film::Film {
    let mut settings = settings();
    settings.half = Half::Both;
    settings.scale_exponent = film::scale_exponent(1.0);
    let mut film = film::Film::new(&settings);
    for (i, tile) in
        [Window { x0: 10, y0: 20, x1: 74, y1: 84 }, Window { x0: 74, y0: 20, x1: 110, y1: 84 }].iter().enumerate()
    {
        let mut part = TileSums::new(*tile, 0..5 + i as u32);
        for (p, pixel) in part.pixels.iter_mut().enumerate() {
            let radiance = glam::Vec3::new(p as f32, 0.3, 1e-3 * p as f32);
            pixel.add(p as u32, radiance, settings.scale_exponent).unwrap();
        }
        film.merge(&part);
    }
    film
}

fn film_chunks(film: &film::Film) -> Vec<wire::FilmChunk> {
    let mut first = 0;
    std::iter::from_fn(|| {
        let chunk = film_rows(film, first)?;
        first += u64::from(chunk.pixels);
        Some(chunk)
    })
    .collect()
}

fn join(chunks: &[wire::FilmChunk]) -> Result<film::Film, WireError> {
    let mut parts = FilmParts::new(&chunks[0])?;
    chunks.iter().try_for_each(|chunk| parts.push(chunk))?;
    parts.finish()
}

#[test]
fn a_film_comes_back_from_its_chunks() {
    let film = filled_film();
    let chunks = film_chunks(&film);
    assert!(chunks.len() > 1);
    assert!(chunks.iter().all(|chunk| chunk.encoded_len() <= crate::limits::MESSAGE_BYTES_MAX));
    let back = join(&chunks).unwrap();
    assert_eq!(back.digest(), film.digest());
    assert_eq!(back, film);
}

#[test]
fn a_film_with_a_piece_missing_or_doubled_is_refused() {
    let chunks = film_chunks(&filled_film());
    assert!(join(&chunks[..1]).is_err());
    assert!(join(&[chunks[0].clone(), chunks[0].clone()]).is_err());
    let spoiled = |spoil: fn(&mut wire::FilmChunk)| {
        let mut chunks = chunks.clone();
        spoil(&mut chunks[0]);
        join(&chunks)
    };
    assert!(spoiled(|_| ()).is_ok());
    assert!(spoiled(|c| c.header = None).is_err());
    assert!(spoiled(|c| c.counts[0].pixels += 1).is_err());
    assert!(spoiled(|c| c.counts[0].counts.push(1)).is_err());
    assert!(spoiled(|c| c.counts.clear()).is_err());
    assert_eq!(spoiled(|c| c.counts[0].counts = vec![0; 4]), Err(WireError::Unbounded));
}

proptest! {
    /// Random bytes as any message: decoded and refused, or decoded and valid, but never a panic.
    #[test]
    fn random_messages_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let _ = wire::Job::decode(&bytes[..]).map(JobSpec::try_from);
        let _ = wire::Hello::decode(&bytes[..]).map(WorkerInfo::try_from);
        let _ = wire::LeaseReply::decode(&bytes[..]).map(types::LeaseReply::try_from);
        let _ = wire::ResultHeader::decode(&bytes[..]).map(ResultHeader::try_from);
        let _ = wire::Progress::decode(&bytes[..]).map(Progress::try_from);
        if let Ok(chunk) = wire::FilmChunk::decode(&bytes[..]) {
            let _ = FilmParts::new(&chunk).map(|mut parts| parts.push(&chunk));
        }
    }
}

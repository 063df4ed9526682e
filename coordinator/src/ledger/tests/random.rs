//! The ledger's first promise, each sample once, whatever random workers do.

use super::*;
use proptest::prelude::{Just, ProptestConfig, Strategy, any, prop, prop_assert, prop_assert_eq, prop_oneof, proptest};

/// What may happen to a random worker.
#[derive(Clone, Debug)]
enum Event {
    Join(u32),
    Lease(u32),
    Submit { which: usize, trace_ms: u64, again: bool },
    Panic(usize),
    BadScene(usize),
    Beat,
    Leave,
    Wait(u64),
}

fn events() -> impl Strategy<Value = Vec<(usize, Event)>> {
    let event = prop_oneof![
        1 => (1u32..5).prop_map(Event::Join),
        4 => (1u32..9).prop_map(Event::Lease),
        8 => (any::<usize>(), 0u64..3000, any::<bool>())
            .prop_map(|(which, trace_ms, again)| Event::Submit { which, trace_ms, again }),
        1 => any::<usize>().prop_map(Event::Panic),
        1 => any::<usize>().prop_map(Event::BadScene),
        2 => Just(Event::Beat),
        1 => Just(Event::Leave),
        3 => (0u64..4000).prop_map(Event::Wait),
    ];
    prop::collection::vec((any::<usize>(), event), 0..200)
}

/// A worker's memory: it keeps leases for ever, also those that are long another's.
type Memory = (WorkerId, Vec<Lease>);

fn play(world: &mut World, workers: &mut Vec<Memory>, who: usize, event: Event) {
    let count = workers.len();
    if let Event::Join(threads) = event {
        return workers.push((world.worker(threads), Vec::new()));
    }
    if let Event::Wait(ms) = event {
        world.now += Duration::from_millis(ms);
        world.ledger.expire(world.now);
        return;
    }
    if count == 0 {
        return;
    }
    let (id, held) = &mut workers[who % count];
    match event {
        Event::Lease(slots) => held.extend(world.lease(*id, slots).unwrap_or_default()),
        Event::Submit { which, trace_ms, again } if !held.is_empty() => {
            let which = which % held.len();
            let lease = if again { held[which].clone() } else { held.swap_remove(which) };
            world.submit(*id, &lease, trace_ms);
            assert_ne!(world.submit(*id, &lease, trace_ms), Verdict::Accepted, "counted twice");
        }
        Event::Panic(which) if !held.is_empty() => {
            let fence = held[which % held.len()].fence;
            let _ = world.ledger.fail(world.now, *id, fence, Failure::Panic("p".into()));
        }
        Event::BadScene(which) if !held.is_empty() => {
            let fence = held[which % held.len()].fence;
            let _ = world.ledger.fail(world.now, *id, fence, Failure::Scene("s".into()));
        }
        Event::Beat => {
            let beat = Heartbeat { worker: *id, fences: held.iter().map(|l| l.fence).collect(), samples: 0 };
            if let Ok(reply) = world.ledger.heartbeat(world.now, &beat) {
                held.retain(|lease| !reply.drop.contains(&lease.fence));
            }
        }
        Event::Leave => world.ledger.leave(*id, &[]),
        _ => {}
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// Whatever happens, no sample counts twice; and unless the ledger gave the job up, saying so, a worker that succeeds
    /// finishes it with every sample counted.
    #[test]
    fn every_sample_counts_exactly_once(
        events in events(),
        sizes in prop::collection::vec((1u32..50, 1u32..40, 1u32..40, 0u32..3), 1..3),
    ) {
        let job = |&(w, h, spp, most): &(u32, u32, u32, u32)| JobSpec { workers_max: NonZeroU32::new(most), ..spec(w, h, spp) };
        let jobs: Vec<JobSpec> = sizes.iter().map(job).collect();
        let mut world = World::new(&jobs);
        let mut workers = Vec::new();
        for (who, event) in events {
            play(&mut world, &mut workers, who, event);
        }
        world.finish();
        prop_assert!(world.counted.values().all(|&n| n == 1));
        for (i, job) in jobs.iter().enumerate() {
            let id = JobId(i as u64 + 1);
            let counted = world.counted.keys().filter(|key| key.0 == id).count() as u64;
            let total = job.settings.film.crop.area() * u64::from(job.settings.spp);
            match world.state(id.0) {
                JobState::Finished => prop_assert_eq!(counted, total),
                JobState::Failed(why) => prop_assert!(why.contains("set aside") || why.contains("no worker can")),
                other => prop_assert!(false, "job {} is {:?}", id, other),
            }
        }
    }
}

//! Thousands of workers: fakes that trace nothing, over real gRPC on loopback, each on a connection of its own. They hold every
//! unit for five seconds and bring made-up sums for it; what the coordinator's process takes for each is measured.
//!
//! TILECAST_CROWD says how many there are: few in CI, as many as the machine holds in `just crowd`. What ten thousand would take
//! beyond that is the same for each, as `scaling.rs` shows of the ledger.

use crate::harness::{Folder, coordinator, cpu_seconds, open_many_files, scene};
use std::collections::HashMap;
use std::convert::Infallible;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tilecast_core::film::{TileSums, sums};
use tilecast_core::scene::Digest;
use tilecast_proto::convert::work_key;
use tilecast_proto::transport::{Connector, Line};
use tilecast_proto::types::{JobId, Lease, LeaseReply, ResultHeader, Unit, WorkerId, WorkerInfo};
use tilecast_proto::wire;
use tilecast_proto::wire::work_client::WorkClient;
use tokio::sync::watch;
use tokio::time::{Instant, MissedTickBehavior, interval, sleep, sleep_until};
use tonic::{Code, Status};

/// A unit takes so long,
const UNIT: Duration = Duration::from_secs(5);
/// and so long after the workers have come, in units, is looked on.
const UNITS_LOOKED_ON: u32 = 4;
/// The whole crowd that one core must be enough for.
const CROWD: f64 = 10_000.0;
/// So many tell whether a coordinator falls behind,
const MANY: u64 = 1000;
/// and so many what each of them costs: fewer find it asleep, and wake it up for every call.
const BUSY: u64 = 5000;
/// A fake's units are small on the wire, as those of so many workers must be: 16 pixels a side.
const TILE: &str = "16";

fn fakes() -> u64 {
    std::env::var("TILECAST_CROWD").ok().and_then(|n| n.parse().ok()).unwrap_or(200)
}

/// How long answers have taken, in order.
type Answers = Arc<Mutex<Vec<(Instant, Duration)>>>;

/// Sums that nobody traced, as large on the wire as traced ones.
fn made_up(unit: &Unit) -> Vec<u8> {
    let mut tile = TileSums::new(unit.tile, unit.samples.clone());
    for (i, value) in tile.pixels.iter_mut().flat_map(|pixel| pixel.0.as_flattened_mut()).enumerate() {
        *value = (i as i128 + 1) << 40;
    }
    sums::encode(&tile.pixels)
}

/// One fake, until `end`. Who was silent for too long, on a machine with too much else to do, comes again; how often that was.
async fn fake(address: String, instance: u64, answers: Answers, mut end: watch::Receiver<bool>) -> u32 {
    let line = Connector::tcp(&address).expect("an address").connect().await.expect("a coordinator");
    let mut lapses = 0;
    loop {
        tokio::select! {
            lapsed = work(WorkClient::new(line.clone()), instance, &answers) => {
                let Err(status) = lapsed;
                assert_eq!(status.code(), Code::NotFound, "{status}");
                lapses += 1;
            }
            _ = end.wait_for(|&ended| ended) => return lapses,
        }
    }
}

/// Ends when the coordinator knows it no more.
async fn work(mut rpc: WorkClient<Line>, instance: u64, answers: &Answers) -> Result<Infallible, Status> {
    let info = WorkerInfo {
        threads: 1,
        isa: String::new(),
        host: String::new(),
        pid: 1,
        name: String::new(),
        cpu: String::new(),
        instance,
    };
    let welcome = rpc.register(wire::Hello::from(info)).await?.into_inner();
    let worker = WorkerId(welcome.worker);
    let mut keys: HashMap<JobId, Digest> = HashMap::new();
    let mut held: Vec<Lease> = Vec::new();
    let mut beats = interval(Duration::from_millis(welcome.heartbeat_ms.into()));
    beats.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut done = Instant::now() + UNIT;
    loop {
        if held.len() < 2 {
            let known_jobs = keys.keys().map(|job| job.0).collect();
            let request = wire::LeaseRequest { worker: worker.0, slots: 2 - held.len() as u32, known_jobs };
            let asked = Instant::now();
            let reply: LeaseReply = rpc.lease(request).await?.into_inner().try_into().expect("valid");
            answers.lock().expect("no panic").push((asked, asked.elapsed()));
            keys.extend(reply.jobs.iter().map(|work| (work.job, work_key(&work.scene, &work.settings))));
            held.extend(reply.leases);
        }
        tokio::select! {
            _ = beats.tick() => {
                let fences = held.iter().map(|lease| lease.fence.0).collect();
                rpc.heartbeat(wire::HeartbeatRequest { worker: worker.0, fences, samples: 0 }).await?;
            }
            () = sleep_until(done), if !held.is_empty() => {
                done = Instant::now() + UNIT;
                let Lease { fence, unit } = held.remove(0);
                let data = made_up(&unit);
                let header = ResultHeader {
                    worker,
                    fence,
                    key: keys[&unit.job],
                    unit,
                    // Units are cut to take about a second.
                    trace: Duration::from_secs(1),
                    waited: Duration::ZERO,
                    bytes: data.len(),
                };
                let chunk = wire::ResultChunk { header: Some(header.into()), data: data.into() };
                let asked = Instant::now();
                rpc.submit(tokio_stream::iter([chunk])).await?;
                answers.lock().expect("no panic").push((asked, asked.elapsed()));
            }
        }
    }
}

/// The long form fails if the coordinator's work for a worker grows with how many there are, or if it falls behind; of few, what a
/// coordinator does however many there are is most: a client watches, tiles are added up.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_crowd_of_workers_is_served_by_less_than_one_core() {
    let (count, folder) = (fakes(), Folder::new());
    open_many_files();
    let cluster = coordinator(&folder);
    let pid = cluster.process.pid();
    let scene = scene("cornell-box/scene.xml");
    // More than they will do.
    let size = ["--size", "1024x1024", "--spp", "1000000000", "--tile", TILE];
    let mut job = cluster.submit(&folder, &[&[scene.as_str()], size.as_slice()].concat());
    job.event("started");

    let (stop, end) = watch::channel(false);
    let answers = Answers::default();
    let mut crowd = tokio::task::JoinSet::new();
    for instance in 1..=count {
        crowd.spawn(fake(cluster.address.clone(), instance, Arc::clone(&answers), end.clone()));
        // They come over a unit's time, as they would bring results then.
        sleep(UNIT / u32::try_from(count).expect("a crowd")).await;
    }
    sleep(UNIT).await;
    let (begun, before) = (Instant::now(), cpu_seconds(pid));
    sleep(UNIT * UNITS_LOOKED_ON).await;
    let (elapsed, cores) = (begun.elapsed(), (cpu_seconds(pid) - before) / begun.elapsed().as_secs_f64());
    stop.send(true).expect("they are there");
    let mut lapses = 0;
    while let Some(one) = crowd.join_next().await {
        lapses += one.expect("a fake does not panic");
    }
    let answers = answers.lock().expect("no panic");
    // The mean answer of a part of the time that was looked on.
    let mean = |from: f64, to: f64| {
        let part = begun + elapsed.mul_f64(from)..begun + elapsed.mul_f64(to);
        let of: Vec<f64> =
            answers.iter().filter(|(asked, _)| part.contains(asked)).map(|(_, took)| took.as_secs_f64()).collect();
        (of.iter().sum::<f64>() / of.len() as f64, of.len())
    };
    let ((first, _), (last, _), (_, all)) = (mean(0.0, 0.5), mean(0.5, 1.0), mean(0.0, 1.0));
    let of_crowd = cores * CROWD / count as f64;
    eprintln!(
        "{count} workers: {cores:.3} cores, so {of_crowd:.2} for {CROWD}; answers took {first:.4} s, then {last:.4} s; \
         {lapses} lapsed"
    );
    assert!(all as u64 > count, "{all} answers only");
    if count >= MANY {
        assert_eq!(lapses, 0, "some were not heard in time");
        assert!(all as f64 > 0.9 * count as f64 * f64::from(UNITS_LOOKED_ON), "{all} answers only");
        assert!(cores < 1.0, "{cores} cores for {count} workers");
        assert!(count < BUSY || of_crowd < 1.0, "{cores} cores for {count} workers, so {of_crowd} for {CROWD}");
        assert!(last < 2.0 * first + 0.05, "answers take longer and longer: {first} s, then {last} s");
    }
    let state = cluster.status(&folder, "job");
    assert_eq!(state[0]["state"], "running", "there was not enough to do");
}

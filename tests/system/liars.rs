//! Workers that bring wrong sums on purpose: with `verify` they are found, what they brought is taken out, and the film has
//! the bits of honest work. No honest worker is accused, since bits either agree or do not.

use crate::cluster::{self, Fixture};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use tilecast_core::film::sums;
use tilecast_core::trace::Tracer;
use tilecast_proto::convert::work_key;
use tilecast_proto::transport::{Connector, Memory};
use tilecast_proto::types::{LeaseReply, ResultHeader, WorkerId, WorkerInfo};
use tilecast_proto::wire;
use tilecast_proto::wire::work_client::WorkClient;
use tonic::Code;

/// Samples a second that the workers here claim: low, so that units are small and many.
const CLAIMED_RATE: f64 = 4000.0;

/// Works until it is shut out; every tenth result is wrong for a liar. Gives how many were.
async fn work(memory: Memory, tracer: Arc<Tracer>, instance: u64, lies: bool) -> u32 {
    let line = Connector::Memory(memory).connect().await.expect("a coordinator");
    let mut rpc = WorkClient::new(line);
    let info = WorkerInfo {
        threads: 1,
        isa: String::new(),
        host: String::new(),
        pid: 1,
        name: instance.to_string(),
        cpu: String::new(),
        instance,
    };
    let mut told = 0;
    let mut count = instance;
    let key = work_key(&cluster::job().scene, &cluster::settings());
    loop {
        let worker = match rpc.register(wire::Hello::from(info.clone())).await {
            Ok(welcome) => welcome.into_inner().worker,
            Err(status) if status.code() == Code::PermissionDenied => return told,
            Err(status) => panic!("{status}"),
        };
        loop {
            let request = wire::LeaseRequest { worker, slots: 2, known_jobs: Vec::new() };
            let Ok(reply) = rpc.lease(request).await else { break };
            let reply = LeaseReply::try_from(reply.into_inner()).expect("a valid reply");
            for lease in reply.leases {
                let unit = lease.unit;
                let traced = tracer.trace(unit.tile, unit.samples.clone(), &AtomicBool::new(false));
                let mut tile = traced.expect("a value").expect("not stopped");
                count += 1;
                if lies && count.is_multiple_of(10) {
                    told += 1;
                    let pixel = count as usize % tile.pixels.len();
                    tile.pixels[pixel].0[0][1] += 1;
                }
                let data = sums::encode(&tile.pixels);
                let header = ResultHeader {
                    worker: WorkerId(worker),
                    fence: lease.fence,
                    trace: Duration::from_secs_f64(unit.len() as f64 / CLAIMED_RATE),
                    waited: Duration::ZERO,
                    unit,
                    key,
                    bytes: data.len(),
                };
                let chunk = wire::ResultChunk { header: Some(header.into()), data: data.into() };
                // A refusal is seen at the next request for work.
                let _ = rpc.submit(tokio_stream::iter([chunk])).await;
            }
        }
    }
}

#[tokio::test(start_paused = true)]
async fn a_liar_among_four_is_found_and_the_image_is_right() {
    let runs: u64 = std::env::var("TILECAST_RUNS").ok().and_then(|n| n.parse().ok()).unwrap_or(8);
    let expected = cluster::direct();
    let tracer = cluster::tracer();
    let (mut lied, mut caught) = (0, 0);
    for run in 0..runs {
        let Fixture { memory, client, _coordinator } = Fixture::verifying(0.1).await;
        let job = cluster::submit(&client).await;
        // The liar's first lie comes at another place each time.
        let instance = |i: u64| 1000 * (i + 1) + run;
        let mut workers: Vec<_> =
            (0..4).map(|i| tokio::spawn(work(memory.clone(), Arc::clone(&tracer), instance(i), i == 0))).collect();
        assert_eq!(cluster::finish(&client, job).await, expected, "run {run}");
        let honest = workers.split_off(1);
        assert!(honest.iter().all(|worker| !worker.is_finished()), "run {run}: an honest worker was shut out");
        honest.iter().for_each(|worker| worker.abort());
        // If it was shut out it learns so at once; else it waits for work.
        let liar = tokio::time::timeout(Duration::from_secs(20), workers.remove(0)).await;
        lied += 1;
        caught += u32::from(liar.is_ok_and(|told| told.is_ok_and(|told| told > 0)));
    }
    assert!(caught * 100 >= lied * 99, "{caught} of {lied} were caught");
}

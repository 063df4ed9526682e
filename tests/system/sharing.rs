//! How scenes come to many workers: a shared folder first, and from the coordinator in turns.

use crate::cluster::Fixture;
use crate::harness::{Folder, Running, SMALL, coordinator_with, scene};
use std::time::Duration;
use tilecast_core::scene::Digest;
use tilecast_proto::client::chunks;
use tilecast_proto::convert::digest_bytes;
use tilecast_proto::limits::STREAM_IDLE_MS_MAX;
use tilecast_proto::transport::{Connector, Line, Memory};
use tilecast_proto::wire::jobs_client::JobsClient;
use tilecast_proto::wire::work_client::WorkClient;
use tilecast_proto::wire::{BlobChunk, BlobRequest, Chunk};
use tokio::time::{Instant, timeout};
use tonic::{Code, Streaming};

/// Blobs that are sent at a time, as docs/cluster.md says.
const TURNS: usize = 16;

/// The second worker has never seen the scene; the coordinator sends it nothing. Fails if the folder is not looked at first, or
/// nothing is put there.
#[test]
fn what_one_worker_has_fetched_the_next_finds_in_the_shared_folder() {
    let folder = Folder::new();
    let cluster = coordinator_with(&folder, &["--listen", "127.0.0.1:0", "--http", "127.0.0.1:0"]);
    let scene = scene("cornell-box/scene.xml");
    let expected = folder.render(&scene, SMALL)["digest"].clone();
    let render = |worker: Running| {
        let job = cluster.submit(&folder, &[&[scene.as_str()], SMALL.as_slice()].concat());
        assert_eq!(job.end().finished()["digest"], expected);
        worker.signal("TERM");
        worker.end()
    };
    let with_cache = || {
        let connect = ["worker", "--threads", "1", "--connect", &cluster.address, "--scene-cache", "cache"];
        // What is fetched is told at this level.
        folder.start_with(connect, &[("TILECAST_LOG", "tilecast_worker=debug")])
    };
    let fetched = |outcome: &crate::harness::Outcome| outcome.stderr.matches("a part of a scene was fetched").count();
    let first = render(with_cache());
    assert!(fetched(&first) > 1, "{}", first.stderr);
    assert_eq!(fetched(&render(with_cache())), 0);
    // Damage is no harm, and repaired.
    let entries = std::fs::read_dir(folder.path("cache")).expect("the cache");
    let blob = entries.map(|entry| entry.expect("an entry").path()).next().expect("a blob");
    std::fs::write(&blob, "damaged").expect("written");
    assert_eq!(fetched(&render(with_cache())), 1);
    assert_eq!(fetched(&render(with_cache())), 0);
}

/// Asks for a blob on a connection of its own.
async fn ask(memory: &Memory, digest: &Digest) -> Streaming<Chunk> {
    let line = Connector::Memory(memory.clone()).connect().await.expect("a coordinator");
    let mut work: WorkClient<Line> = WorkClient::new(line);
    work.get_blob(BlobRequest { digest: digest_bytes(digest) }).await.expect("it is there").into_inner()
}

/// Fails if all are sent at once, if whoever does not read keeps its turn, or if a blob that was broken off looks complete.
#[tokio::test(start_paused = true)]
async fn blobs_are_sent_in_turns_and_who_does_not_read_loses_its_own() {
    let Fixture { memory, _coordinator, .. } = Fixture::verifying(0.0).await;
    // More than waits on the way for a reader that is slow.
    let blob = vec![7; 24 << 20];
    let digest = Digest::of(&blob);
    let part = move |data| BlobChunk { digest: digest_bytes(&digest), bytes: 24 << 20, data };
    let mut jobs = JobsClient::new(Connector::Memory(memory.clone()).connect().await.expect("a coordinator"));
    jobs.put_blob(tokio_stream::iter(chunks(blob.into()).map(part))).await.expect("uploaded");

    let begun = Instant::now();
    let mut first = Vec::new();
    for _ in 0..TURNS {
        let mut stream = ask(&memory, &digest).await;
        assert!(stream.message().await.expect("its turn").is_some());
        first.push(stream);
    }
    let mut next = ask(&memory, &digest).await;
    assert!(timeout(Duration::from_secs(5), next.message()).await.is_err(), "it is not its turn");
    // One that is not wanted any more makes way at once.
    drop(first.pop());
    assert!(timeout(Duration::from_secs(5), next.message()).await.expect("its turn").is_ok());
    let mut last = ask(&memory, &digest).await;
    assert!(last.message().await.expect("its turn").is_some());
    assert!(begun.elapsed() >= Duration::from_millis(STREAM_IDLE_MS_MAX), "{:?}", begun.elapsed());
    let broken_off = loop {
        match first[0].message().await {
            Ok(chunk) => assert!(chunk.is_some(), "it looks complete"),
            Err(status) => break status,
        }
    };
    assert_eq!(broken_off.code(), Code::DeadlineExceeded, "{broken_off}");
}

//! Peers that connect and waste what they can get: honest work goes on, memory stays bounded, and who says nothing is cut
//! off.

use crate::harness::{Folder, SMALL, coordinator, scene};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

/// Of each kind. `just soak` has more.
fn connections() -> usize {
    std::env::var("TILECAST_RUNS").ok().and_then(|n| n.parse::<usize>().ok()).map_or(150, |runs| runs * 5)
}

/// Growth of memory that a flood may cause.
const GROWTH_BYTES_MAX: u64 = 256 << 20;

#[cfg(target_os = "linux")]
fn memory(pid: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).expect("a process");
    let line = status.lines().find(|line| line.starts_with("VmHWM")).expect("its memory");
    line.split_whitespace().nth(1).and_then(|kb| kb.parse::<u64>().ok()).expect("a number") << 10
}

#[cfg(target_os = "linux")]
#[test]
fn a_flood_costs_little_memory_and_no_honest_render() {
    let folder = Folder::new();
    let cluster = coordinator(&folder);
    let before = memory(cluster.process.pid());
    let connect = || TcpStream::connect(&cluster.address).expect("a connection");
    let mut idle: Vec<TcpStream> = (0..connections()).map(|_| connect()).collect();
    let mut half: Vec<TcpStream> = (0..connections()).map(|_| connect()).collect();
    for stream in &mut half {
        // The preface, empty settings, and the beginning of a header block of 16 kB that never ends.
        stream.write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0").expect("sent");
        stream.write_all(b"\0\x40\0\x01\0\0\0\0\x01").expect("sent");
        // Whoever is cut off already is cut off.
        let _ = stream.write_all(&[0x40; 8000]);
    }
    let _worker = cluster.worker(&folder);
    let scene = scene("cornell-box/scene.xml");
    let job = cluster.submit(&folder, &[&[scene.as_str()], SMALL.as_slice()].concat());
    assert_eq!(job.end().finished()["digest"], folder.render(&scene, SMALL)["digest"]);
    for stream in &mut idle {
        stream.set_read_timeout(Some(Duration::from_secs(30))).expect("a timeout");
        let mut rest = Vec::new();
        // An end or a reset, but no silence for ever.
        if let Err(error) = stream.read_to_end(&mut rest) {
            let silent = [std::io::ErrorKind::WouldBlock, std::io::ErrorKind::TimedOut];
            assert!(!silent.contains(&error.kind()), "still open");
        }
    }
    let growth = memory(cluster.process.pid()) - before;
    assert!(growth < GROWTH_BYTES_MAX, "{} MiB", growth >> 20);
}

//! Peers that connect and waste what they can get: honest work goes on, memory stays bounded, and who says nothing is cut
//! off. The short form is part of every test run; with TILECAST_RUNS of 100 or more it is the flood of docs/security.md, for a
//! minute, and how much it slows an honest render down is measured.

use crate::harness::{Coordinator, Folder, SMALL, coordinator, is_soak, open_many_files, scene};
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Growth of memory that a flood may cause.
const GROWTH_BYTES_MAX: u64 = 256 << 20;
/// How much longer an honest render may take.
const SLOWDOWN_MAX: f64 = 1.2;

/// Who cannot connect so often in this time has something that keeps it from it.
const PATIENCE: Duration = Duration::from_secs(60);

/// How many of each kind, and for how long.
struct Size {
    idle: usize,
    half_sent: usize,
    bombers: usize,
    lasts: Duration,
}

const SHORT: Size = Size { idle: 150, half_sent: 150, bombers: 8, lasts: Duration::from_secs(1) };
const FULL: Size = Size { idle: 1000, half_sent: 10_000, bombers: 50, lasts: Duration::from_secs(60) };

/// An HTTP/2 preface and empty settings.
const GREETING: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0";

/// A frame of HTTP/2.
fn frame(kind: u8, flags: u8, stream: u32, payload: &[u8]) -> Vec<u8> {
    let length = u32::try_from(payload.len()).expect("a short frame").to_be_bytes();
    [&length[1..], &[kind, flags], &stream.to_be_bytes(), payload].concat()
}

/// The beginning of a header block of 16 kB that never ends.
fn half_sent() -> Vec<u8> {
    let whole = frame(1, 0, 1, &[0x40; 16 << 10]);
    [GREETING, &whole[..8000]].concat()
}

/// The headers of a call to `path`, in literals (RFC 7541, 6.2).
fn call(path: &str) -> Vec<u8> {
    let literal = |text: &str| [&[u8::try_from(text.len()).expect("short")], text.as_bytes()].concat();
    let mut block = vec![0x83, 0x86, 0x04];
    block.extend(literal(path));
    for (name, value) in [("te", "trailers"), ("content-type", "application/grpc"), ("grpc-encoding", "gzip")] {
        block.push(0);
        block.extend(literal(name).into_iter().chain(literal(value)));
    }
    block
}

/// A call whose message is zeros without end, compressed a thousandfold.
fn zip_bomb(stream: u32) -> Vec<u8> {
    let mut zip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
    zip.write_all(&vec![0; 8 << 20]).expect("memory");
    let zip = zip.finish().expect("memory");
    let message = [&[1], &u32::try_from(zip.len()).expect("short").to_be_bytes()[..], &zip].concat();
    [frame(1, 4, stream, &call("/tilecast.v1.Jobs/SubmitJob")), frame(0, 1, stream, &message)].concat()
}

/// A header of 4 kB that is put into the table once and named ten thousand times: 40 MB of headers (RFC 7541, 6.2.1 and 6.1).
fn header_bomb(stream: u32) -> Vec<u8> {
    let mut block = call("/tilecast.v1.Jobs/Greet");
    // A literal of 4,000 bytes: 127 in the prefix, the rest in groups of seven bits.
    block.extend([0x40, 1, b'x', 0x7f, 0xa1, 0x1e]);
    block.extend([b'y'; 4000]);
    block.extend([0xbe; 10_000]);
    frame(1, 5, stream, &block)
}

/// What goes on until it is told to end.
struct Flood {
    end: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
    /// Connections made, all in all.
    made: Arc<AtomicU64>,
    /// Connections that are open at once when all have been made.
    wanted: u64,
}

impl Flood {
    fn begin(address: &str, size: &Size) -> Self {
        let wanted = (size.idle + size.half_sent + size.bombers) as u64;
        let mut flood = Self { end: Arc::default(), threads: Vec::new(), made: Arc::default(), wanted };
        flood.hold(address, size.idle, Vec::new());
        flood.hold(address, size.half_sent, half_sent());
        flood.bomb(address, size.bombers);
        flood
    }

    /// Keeps `count` connections open on which `greeting` was said; makes those anew that are cut off.
    fn hold(&mut self, address: &str, count: usize, greeting: Vec<u8>) {
        let (address, end, made) = (address.to_owned(), Arc::clone(&self.end), Arc::clone(&self.made));
        self.threads.push(std::thread::spawn(move || {
            let mut held: Vec<Option<TcpStream>> = (0..count).map(|_| None).collect();
            while !end.load(Relaxed) {
                for place in &mut held {
                    if place.as_mut().is_none_or(is_cut_off) && !end.load(Relaxed) {
                        *place = TcpStream::connect(&address).ok();
                        made.fetch_add(1, Relaxed);
                        if let Some(stream) = place {
                            let _ = stream.set_nonblocking(true);
                            let _ = stream.write_all(&greeting);
                        }
                    }
                }
                std::thread::sleep(Duration::from_millis(200));
            }
        }));
    }

    /// Sends bombs on `count` connections, 200 a second; answers are not read.
    fn bomb(&mut self, address: &str, count: usize) {
        let (address, end, made) = (address.to_owned(), Arc::clone(&self.end), Arc::clone(&self.made));
        self.threads.push(std::thread::spawn(move || {
            let bombs: Vec<Vec<u8>> = [1, 3, 5].iter().flat_map(|&n| [zip_bomb(n), header_bomb(n + 100)]).collect();
            let mut held: Vec<Option<TcpStream>> = (0..count).map(|_| None).collect();
            for (place, bomb) in (0..count).cycle().zip(bombs.iter().cycle()) {
                if end.load(Relaxed) {
                    return;
                }
                if held[place].as_mut().is_none_or(is_cut_off) {
                    held[place] = TcpStream::connect(&address).ok();
                    made.fetch_add(1, Relaxed);
                    if let Some(stream) = &mut held[place] {
                        let _ = stream.write_all(GREETING);
                        let _ = stream.set_nonblocking(true);
                    }
                }
                let sent = held[place].as_mut().is_some_and(|stream| stream.write_all(bomb).is_ok());
                if !sent {
                    held[place] = None;
                }
                std::thread::sleep(Duration::from_millis(5));
            }
        }));
    }

    /// Whether every connection has been made once.
    fn is_whole(&self) -> bool {
        self.made.load(Relaxed) >= self.wanted
    }

    /// Ends it; how many connections it has made.
    fn end(self) -> u64 {
        self.end.store(true, Relaxed);
        self.threads.into_iter().for_each(|thread| thread.join().expect("a flood does not panic"));
        self.made.load(Relaxed)
    }
}

/// Whether the other side has ended a connection; what it says is passed over.
fn is_cut_off(stream: &mut TcpStream) -> bool {
    let mut said = [0; 4096];
    loop {
        match stream.read(&mut said) {
            Ok(0) => return true,
            Ok(_) => {}
            Err(error) => return error.kind() != ErrorKind::WouldBlock,
        }
    }
}

#[cfg(target_os = "linux")]
fn memory(pid: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).expect("a process");
    let line = status.lines().find(|line| line.starts_with("VmHWM")).expect("its memory");
    line.split_whitespace().nth(1).and_then(|kb| kb.parse::<u64>().ok()).expect("a number") << 10
}

/// The shortest of the renders made until it is `enough`, in seconds: what else the machine does only makes them longer.
fn honest(folder: &Folder, cluster: &Coordinator, args: &[&str], enough: impl Fn(Duration) -> bool) -> f64 {
    let scene = scene("cornell-box/scene.xml");
    let (begun, mut shortest) = (Instant::now(), f64::INFINITY);
    let expected = folder.render(&scene, args)["digest"].clone();
    while !enough(begun.elapsed()) || shortest == f64::INFINITY {
        let job = cluster.submit(folder, &[&[scene.as_str()], args].concat());
        let finished = job.end().finished();
        assert_eq!(finished["digest"], expected);
        shortest = shortest.min(finished["seconds"].as_f64().expect("a time"));
    }
    shortest
}

#[cfg(target_os = "linux")]
#[test]
fn a_flood_costs_little_memory_and_no_honest_render() {
    let size = if is_soak() { FULL } else { SHORT };
    open_many_files();
    let folder = Folder::new();
    let cluster = coordinator(&folder);
    let worker = cluster.worker(&folder);
    // Small films: those of jobs that are done are kept for a while, and are no part of the flood.
    let args: &[&str] = if is_soak() { &["--size", "32x32", "--spp", "1152", "--tile", "16"] } else { &SMALL };
    let calm = honest(&folder, &cluster, args, |elapsed| elapsed >= size.lasts / 3);
    let before = memory(cluster.process.pid());

    let flood = Flood::begin(&cluster.address, &size);
    // A busy machine takes its time to connect so often.
    let enough = |elapsed| elapsed >= size.lasts && (flood.is_whole() || elapsed >= size.lasts + PATIENCE);
    let flooded = honest(&folder, &cluster, args, enough);
    let whole = flood.is_whole();
    let made = flood.end();
    let growth = memory(cluster.process.pid()) - before;
    eprintln!("{made} connections: {} MiB more; {calm:.2} s became {flooded:.2} s", growth >> 20);
    assert!(whole, "{made} connections are no flood");
    assert!(growth < GROWTH_BYTES_MAX, "{} MiB", growth >> 20);
    // In the short form a render takes a moment, and the flood begins while it does.
    assert!(!is_soak() || flooded < SLOWDOWN_MAX * calm, "{flooded} s instead of {calm} s");
    for process in [worker, cluster.process] {
        process.signal("TERM");
        assert_eq!(process.end().code, Some(0), "nothing exits but who is told to");
    }
}

/// No silence is for ever: who connects and says nothing is cut off.
#[test]
fn who_says_nothing_is_cut_off() {
    let folder = Folder::new();
    let cluster = coordinator(&folder);
    let connect = || TcpStream::connect(&cluster.address).expect("a connection");
    let mut idle: Vec<TcpStream> = (0..SHORT.idle).map(|_| connect()).collect();
    for stream in &mut idle {
        stream.set_read_timeout(Some(Duration::from_secs(30))).expect("a timeout");
        let mut rest = Vec::new();
        if let Err(error) = stream.read_to_end(&mut rest) {
            assert!(![ErrorKind::WouldBlock, ErrorKind::TimedOut].contains(&error.kind()), "still open");
        }
    }
}

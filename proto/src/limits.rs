//! Every limit of the wire, with its reason. Limits that depend on each other are tied by assertions at the end.

/// The longest message: large enough that headers do not matter, small enough that a receiver can buffer many.
pub const MESSAGE_BYTES_MAX: usize = 1 << 20;
/// Bytes of data in one chunk of a stream: a whole 64×64 tile of typical sums, and room for the headers beside it.
pub const CHUNK_BYTES: usize = MESSAGE_BYTES_MAX - HEADER_BYTES_MAX;
/// What a chunk's other fields may take.
const HEADER_BYTES_MAX: usize = 4096;
/// HTTP/2 flow control for one stream: a whole result is on its way before the receiver has read its first byte.
pub const STREAM_WINDOW_BYTES: u32 = 4 << 20;
/// HTTP/2 flow control for one connection: a few results at once.
pub const CONNECTION_WINDOW_BYTES: u32 = 16 << 20;
/// HTTP/2 frames: the fewer, the less bookkeeping; beyond this it no longer shows.
pub const FRAME_BYTES_MAX: u32 = 256 << 10;
/// Buffer of an in-memory connection: one message, so that neither side waits inside one.
pub const MEMORY_BUFFER_BYTES: usize = MESSAGE_BYTES_MAX;
/// Connections waiting to be accepted by an in-memory listener.
pub const MEMORY_BACKLOG: usize = 64;

/// Names people give, host names, instruction sets: shown in one line.
pub const NAME_BYTES_MAX: usize = 256;
/// The text of a failure: a panic message and where it came from.
pub const FAILURE_BYTES_MAX: usize = 4096;

/// Threads of one worker: beyond it the number is taken for a mistake.
pub const THREADS_MAX: u32 = 4096;
/// Slots a thread: one unit being traced, and one waiting so that the thread never does.
pub const SLOTS_PER_THREAD: u32 = 2;
/// Slots in one request: what the largest worker can hold.
pub const SLOTS_MAX: u32 = THREADS_MAX * SLOTS_PER_THREAD;
/// Leases in one reply; small units come many at a time, and the next request is not far.
pub const LEASES_PER_REPLY_MAX: usize = 256;
/// Leases one worker may hold: its slots, each with a few small units.
pub const LEASES_HELD_MAX: usize = 4 * SLOTS_MAX as usize;
/// Jobs whose description a worker remembers and names in its requests.
pub const KNOWN_JOBS_MAX: usize = 64;

/// Side of a tile in pixels: a tile's sums are kept in memory several times on their way.
pub const TILE_SIDE_MAX: u32 = 256;
/// Side of a tile if nobody chooses: small enough for many workers, large enough that a unit is worth its message.
pub const TILE_SIDE_DEFAULT: u32 = 64;
/// Encoded sums of one pixel at their longest: replicates × channels × (head and 16 bytes).
pub const PIXEL_BYTES_MAX: usize = tilecast_core::film::REPLICATES * 3 * 17;
/// An encoded result.
pub const RESULT_BYTES_MAX: usize = (TILE_SIDE_MAX * TILE_SIDE_MAX) as usize * PIXEL_BYTES_MAX;
/// Pixels of a film: 2^26 of them take 14 GB with their counts, at the coordinator and again at the client.
pub const FILM_PIXELS_MAX: u64 = 1 << 26;
/// Ranges of samples of a job, one a tile: 2^16 tiles of 16 pixels are 16 megapixels.
pub const RANGES_MAX: usize = 1 << 16;
/// Pixels in one chunk of a film, so that it fits a message whatever the sums and counts are.
pub const FILM_CHUNK_PIXELS: u32 = 4096;
/// A run of counts on the wire, at its longest.
const COUNT_RUN_BYTES_MAX: usize = 32;

/// One blob: the largest mesh or image of a scene.
pub const BLOB_BYTES_MAX: u64 = 4 << 30;
/// Digests in one message.
pub const DIGESTS_MAX: usize = 16 << 10;
/// A digest on the wire: tag, length, 32 bytes.
const DIGEST_BYTES: usize = 34;

/// A worker says this often which leases it holds.
pub const HEARTBEAT_MS: u64 = 1000;
/// Or this often, where there are thousands.
pub const HEARTBEAT_MS_MAX: u64 = 2000;
/// A lease nobody has renewed for this long lapses: a few heartbeats may be lost without harm.
pub const LEASE_SILENCE_MS: u64 = 6200;
/// How often the coordinator looks for lapsed leases.
pub const EXPIRY_TICK_MS: u64 = 500;
/// Within this time the units of a silent worker are given out again.
pub const REASSIGN_MS_MAX: u64 = 10_000;
/// How long a request for work may wait at the coordinator while there is none.
pub const LEASE_WAIT_MS: u64 = 4000;
/// No call takes longer, streams of bulk aside: behind it the peer is taken for gone.
pub const CALL_MS_MAX: u64 = 10_000;
/// Establishing a connection.
pub const CONNECT_MS_MAX: u64 = 5000;
/// A connection without traffic is probed this often, so that a peer that lost its power is noticed.
pub const KEEP_ALIVE_MS: u64 = 5000;
/// Events of a watched job are at least this far apart: ten a second are enough for eyes.
pub const PROGRESS_INTERVAL_MS: u64 = 100;
/// A stream of bulk on which nothing comes for so long is broken off, and what it had set aside is free again.
pub const STREAM_IDLE_MS_MAX: u64 = 30_000;
/// Headers of one call: ours are short.
pub const HEADERS_BYTES_MAX: u32 = 16 << 10;
/// Streams one connection may have at once: a worker's calls, a client's watches.
pub const STREAMS_MAX: u32 = 256;

const _: () = {
    assert!(CHUNK_BYTES + HEADER_BYTES_MAX <= MESSAGE_BYTES_MAX);
    assert!(FAILURE_BYTES_MAX + 3 * NAME_BYTES_MAX + 512 <= MESSAGE_BYTES_MAX);
    assert!(FRAME_BYTES_MAX <= STREAM_WINDOW_BYTES && STREAM_WINDOW_BYTES <= CONNECTION_WINDOW_BYTES);
    assert!(DIGESTS_MAX * DIGEST_BYTES <= MESSAGE_BYTES_MAX);
    assert!(LEASES_HELD_MAX * 11 <= MESSAGE_BYTES_MAX, "a heartbeat names all leases");
    // A lease takes at most 64 bytes, a job's description 256.
    assert!(LEASES_PER_REPLY_MAX * (64 + 256) <= MESSAGE_BYTES_MAX);
    assert!(FILM_CHUNK_PIXELS as usize * (PIXEL_BYTES_MAX + COUNT_RUN_BYTES_MAX) + 256 <= MESSAGE_BYTES_MAX);
    assert!(RANGES_MAX * 10 + NAME_BYTES_MAX + 512 <= MESSAGE_BYTES_MAX, "a job names the samples of its tiles");
    assert!(HEARTBEAT_MS_MAX * 3 < LEASE_SILENCE_MS, "two lost heartbeats cost nothing");
    assert!(LEASE_SILENCE_MS + EXPIRY_TICK_MS + HEARTBEAT_MS_MAX <= REASSIGN_MS_MAX);
    assert!(LEASE_WAIT_MS * 2 <= CALL_MS_MAX, "a waiting request is not taken for a dead peer");
};

//! Ways as OpenTelemetry has them: one trace a lease, one span for the whole and one below it for each step.

use super::way::{Outcome, Way};
use opentelemetry::trace::{SpanContext, SpanId, SpanKind, Status, TraceFlags, TraceId, TraceState};
use opentelemetry::{InstrumentationScope, KeyValue};
use opentelemetry_sdk::trace::{SpanData, SpanEvents, SpanLinks};
use std::borrow::Cow;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// The span of the whole.
const UNIT: &str = "unit";

/// The spans of a way. `instance` tells this coordinator's leases from those of all others.
pub(super) fn of(instance: u64, way: &Way) -> Vec<SpanData> {
    let mut hash = blake3::Hasher::new();
    hash.update(&instance.to_le_bytes()).update(&way.fence.0.to_le_bytes());
    let mut ids = hash.finalize_xof();
    let mut trace = [0; 16];
    ids.fill(&mut trace);
    let trace = TraceId::from_bytes(trace);
    let mut span = |name: &'static str, parent: SpanId, begin: Duration, end: Duration| {
        let mut id = [0; 8];
        ids.fill(&mut id);
        let id = SpanId::from_bytes(id);
        SpanData {
            span_context: SpanContext::new(trace, id, TraceFlags::SAMPLED, false, TraceState::NONE),
            parent_span_id: parent,
            parent_span_is_remote: false,
            span_kind: SpanKind::Internal,
            name: Cow::Borrowed(name),
            start_time: time(begin),
            end_time: time(end),
            attributes: Vec::new(),
            dropped_attributes_count: 0,
            events: SpanEvents::default(),
            links: SpanLinks::default(),
            status: Status::Unset,
            instrumentation_scope: InstrumentationScope::default(),
        }
    };
    let mut unit = span(UNIT, SpanId::INVALID, way.begun, way.end());
    unit.attributes = attributes(way);
    unit.status = match &way.outcome {
        Some(Outcome::Lapsed) => Status::error("the worker was not heard any more"),
        Some(Outcome::Failed(why)) => Status::error(why.clone()),
        _ => Status::Unset,
    };
    let begins = std::iter::once(way.begun).chain(way.steps.iter().map(|(_, end)| *end));
    let parent = unit.span_context.span_id();
    let steps = begins.zip(&way.steps).map(|(begin, (step, end))| span(step.name(), parent, begin, *end));
    let steps: Vec<SpanData> = steps.collect();
    std::iter::once(unit).chain(steps).collect()
}

fn attributes(way: &Way) -> Vec<KeyValue> {
    let (tile, samples) = (way.unit.tile, &way.unit.samples);
    let mut all = vec![
        KeyValue::new("tilecast.job", signed(way.unit.job.0)),
        KeyValue::new("tilecast.worker", i64::from(way.worker.number())),
        KeyValue::new("tilecast.tile", format!("{},{},{},{}", tile.x0, tile.y0, tile.x1, tile.y1)),
        KeyValue::new("tilecast.samples", format!("{}..{}", samples.start, samples.end)),
        KeyValue::new("tilecast.lease", signed(way.fence.0)),
    ];
    if !way.name.is_empty() {
        all.push(KeyValue::new("tilecast.worker.name", way.name.clone()));
    }
    if let Some(outcome) = &way.outcome {
        all.push(KeyValue::new("tilecast.outcome", outcome.name()));
    }
    all
}

/// Numbers of jobs and leases count up from one, or from a time in seconds times 2^32.
fn signed(number: u64) -> i64 {
    i64::try_from(number).unwrap_or(i64::MAX)
}

/// The ledger's time is that since 1970, where its coordinator was set up so.
fn time(since_epoch: Duration) -> SystemTime {
    UNIX_EPOCH + since_epoch
}

#[cfg(test)]
mod tests {
    use super::super::way::Step;
    use super::super::way::tests::{header, lent};
    use super::*;

    /// Collectors add what they get: the same lease always has the same name, and no two have.
    #[test]
    fn ids_belong_to_one_lease_of_one_coordinator() {
        let mut way =
            Way::brought(Duration::from_secs(9), &header(Duration::from_secs(1), Duration::ZERO), Some(lent()));
        way.step(Step::Transfer, Duration::from_secs(10));
        let (spans, again, other) = (of(1, &way), of(1, &way), of(2, &way));
        assert_eq!(spans, again);
        let id = |span: &SpanData| span.span_context.trace_id();
        assert!(spans.iter().all(|span| id(span) == id(&spans[0])));
        assert_ne!(id(&spans[0]), id(&other[0]));
        let mut own: Vec<SpanId> = spans.iter().map(|span| span.span_context.span_id()).collect();
        own.sort_by_key(|id| id.to_bytes());
        own.dedup();
        assert_eq!(own.len(), 4, "a unit and three steps");
    }
}

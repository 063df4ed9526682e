//! Metrics in Prometheus' text format, read from the ledger and its counters when someone asks. docs/metrics.md says what they
//! are good for; a test holds page and table to each other.

use super::Inner;
use super::live::state_name;
use crate::ledger::Ledger;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use prometheus::{CounterVec, Encoder, GaugeVec, Opts, Registry, TextEncoder};
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;
use tilecast_core::film::file::Target;
use tilecast_proto::types::{Progress, WorkerStatus};

/// Workers with lines of their own: a monitor keeps every line for weeks.
const WORKERS_TOLD_MAX: usize = 1000;

/// Whether it only grows.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Counter,
    Gauge,
}

/// Name, kind, labels and meaning. Counters begin anew with the coordinator.
const METRICS: [(&str, Kind, &[&str], &str); 27] = [
    ("tilecast_build_info", Kind::Gauge, &["version"], "1, with the coordinator's version"),
    ("tilecast_samples_total", Kind::Counter, &[], "Samples counted"),
    ("tilecast_samples_per_second", Kind::Gauge, &[], "What all workers together trace, as last measured"),
    ("tilecast_units_total", Kind::Counter, &[], "Units of work counted"),
    ("tilecast_units", Kind::Gauge, &["state"], "Units that are cut and not counted, by state"),
    ("tilecast_leases_lost_total", Kind::Counter, &[], "Leases that lapsed since their worker fell silent"),
    ("tilecast_duplicates_total", Kind::Counter, &[], "Results that another had brought before"),
    ("tilecast_result_bytes_total", Kind::Counter, &[], "Bytes of results received"),
    ("tilecast_scene_bytes_total", Kind::Counter, &["direction"], "Bytes of scenes received and sent"),
    ("tilecast_merge_seconds_total", Kind::Counter, &[], "Time spent checking and adding up results"),
    ("tilecast_film_bytes", Kind::Gauge, &[], "Memory taken by films"),
    ("tilecast_jobs", Kind::Gauge, &["state"], "Jobs that are remembered, by state"),
    ("tilecast_job_samples", Kind::Gauge, &["job", "name"], "Samples counted of a job that goes on"),
    ("tilecast_job_samples_wanted", Kind::Gauge, &["job", "name"], "Samples that it is to have"),
    (
        "tilecast_job_error_ratio",
        Kind::Gauge,
        &["job", "name"],
        "Estimated relative error of what it traces, after the last round",
    ),
    (
        "tilecast_job_target_ratio",
        Kind::Gauge,
        &["job", "name"],
        "The error that its image is to have, if it ends at one",
    ),
    (
        "tilecast_job_left_seconds",
        Kind::Gauge,
        &["job", "name"],
        "Time until its image is done at the speed of those who work on it",
    ),
    ("tilecast_workers", Kind::Gauge, &[], "Workers that are there"),
    ("tilecast_threads", Kind::Gauge, &[], "Threads of all of them"),
    ("tilecast_worker_threads", Kind::Gauge, &["worker", "name", "host"], "Threads of a worker"),
    (
        "tilecast_worker_samples_per_second",
        Kind::Gauge,
        &["worker", "name", "host"],
        "What it traces, as last measured",
    ),
    ("tilecast_worker_units_total", Kind::Counter, &["worker", "name", "host"], "Units it has brought"),
    ("tilecast_worker_leases", Kind::Gauge, &["worker", "name", "host"], "Units it holds"),
    ("tilecast_worker_silent_seconds", Kind::Gauge, &["worker", "name", "host"], "Time since it was heard"),
    ("tilecast_events_total", Kind::Counter, &["kind"], "Events, by kind, as in the log"),
    ("tilecast_watchers", Kind::Gauge, &[], "Open pages"),
    ("tilecast_traces_total", Kind::Counter, &["outcome"], "Traces of units that the collector took, or did not"),
];

/// Values by name and labels.
type Values = Vec<(&'static str, Vec<String>, f64)>;

/// All metrics.
pub async fn metrics(State(site): State<Arc<Inner>>) -> Response {
    match text(&values(&site)) {
        Ok(text) => ([(header::CONTENT_TYPE, prometheus::TEXT_FORMAT)], text).into_response(),
        Err(error) => {
            tracing::error!(%error, "metrics cannot be told");
            StatusCode::INTERNAL_SERVER_ERROR.into_response()
        }
    }
}

fn values(site: &Inner) -> Values {
    let (shared, mut values) = (&site.shared, Values::new());
    shared.with_ledger(|ledger, now| {
        totals(ledger, &mut values);
        jobs(ledger, now, &mut values);
        workers(&ledger.workers(now), &mut values);
    });
    let traffic = &shared.traffic;
    let mut put = |name, labels: &[&str], value: f64| values.push((name, owned(labels), value));
    put("tilecast_build_info", &[env!("CARGO_PKG_VERSION")], 1.0);
    put("tilecast_duplicates_total", &[], traffic.duplicates.load(Relaxed) as f64);
    put("tilecast_result_bytes_total", &[], traffic.results.load(Relaxed) as f64);
    put("tilecast_scene_bytes_total", &["in"], traffic.scenes_in.load(Relaxed) as f64);
    put("tilecast_scene_bytes_total", &["out"], traffic.scenes_out.load(Relaxed) as f64);
    put("tilecast_film_bytes", &[], shared.films.bytes() as f64);
    put("tilecast_watchers", &[], site.feed.watchers() as f64);
    if let Some(told) = shared.told.get() {
        put("tilecast_traces_total", &["sent"], told.sent.load(Relaxed) as f64);
        put("tilecast_traces_total", &["dropped"], told.dropped.load(Relaxed) as f64);
    }
    for (kind, count) in shared.events.counts() {
        put("tilecast_events_total", &[kind.name()], count as f64);
    }
    values
}

fn totals(ledger: &Ledger, values: &mut Values) {
    let (totals, open) = (ledger.totals(), ledger.open_units());
    let mut put = |name, labels: &[&str], value: f64| values.push((name, owned(labels), value));
    put("tilecast_samples_total", &[], totals.samples as f64);
    put("tilecast_units_total", &[], totals.units as f64);
    put("tilecast_leases_lost_total", &[], totals.leases_lost as f64);
    put("tilecast_merge_seconds_total", &[], totals.merging.as_secs_f64());
    put("tilecast_units", &["lent"], open.lent as f64);
    put("tilecast_units", &["returned"], open.returned as f64);
    put("tilecast_units", &["set_aside"], open.set_aside as f64);
}

fn jobs(ledger: &Ledger, now: Duration, values: &mut Values) {
    let all: Vec<Progress> = ledger.jobs().into_iter().filter_map(|id| ledger.progress(now, id).ok()).collect();
    for name in ["queued", "running", "finished", "failed", "cancelled"] {
        let count = all.iter().filter(|job| state_name(&job.state) == name).count();
        values.push(("tilecast_jobs", owned(&[name]), count as f64));
    }
    for job in all.iter().filter(|job| !job.state.is_final()) {
        let labels = vec![job.job.to_string(), job.name.clone()];
        let mut put = |name, value: f64| values.push((name, labels.clone(), value));
        put("tilecast_job_samples", job.samples_done as f64);
        put("tilecast_job_samples_wanted", job.samples_total as f64);
        if let Some(error) = job.relative_error {
            put("tilecast_job_error_ratio", f64::from(error.value));
        }
        if let Some(Target::Image(target) | Target::Pixels(target)) = ledger.aim(job.job).and_then(|aim| aim.target) {
            put("tilecast_job_target_ratio", f64::from(target));
        }
        let speed = job.samples_per_second;
        if speed > 0.0 {
            put("tilecast_job_left_seconds", ledger.left(job.job) as f64 / speed);
        }
    }
}

fn workers(all: &[WorkerStatus], values: &mut Values) {
    let mut put = |name, value: f64| values.push((name, Vec::new(), value));
    put("tilecast_workers", all.len() as f64);
    put("tilecast_threads", all.iter().map(|worker| f64::from(worker.info.threads)).sum());
    put("tilecast_samples_per_second", all.iter().map(|worker| worker.samples_per_second).sum());
    for worker in all.iter().take(WORKERS_TOLD_MAX) {
        let labels = vec![worker.worker.number().to_string(), worker.info.name.clone(), worker.info.host.clone()];
        let mut put = |name, value: f64| values.push((name, labels.clone(), value));
        put("tilecast_worker_threads", f64::from(worker.info.threads));
        put("tilecast_worker_samples_per_second", worker.samples_per_second);
        put("tilecast_worker_units_total", worker.units_done as f64);
        put("tilecast_worker_leases", f64::from(worker.leases));
        put("tilecast_worker_silent_seconds", worker.silent.as_secs_f64());
    }
}

fn owned(labels: &[&str]) -> Vec<String> {
    labels.iter().map(|&label| label.to_owned()).collect()
}

/// The values in the order of the table.
fn text(values: &Values) -> prometheus::Result<Vec<u8>> {
    let registry = Registry::new();
    for (name, kind, labels, help) in METRICS {
        let mine = values.iter().filter(|(of, ..)| *of == name);
        if kind == Kind::Counter {
            let counters = CounterVec::new(Opts::new(name, help), labels)?;
            for (_, labels, value) in mine {
                counters.get_metric_with_label_values(labels)?.inc_by(*value);
            }
            registry.register(Box::new(counters))?;
        } else {
            let gauges = GaugeVec::new(Opts::new(name, help), labels)?;
            for (_, labels, value) in mine {
                gauges.get_metric_with_label_values(labels)?.set(*value);
            }
            registry.register(Box::new(gauges))?;
        }
    }
    let mut text = Vec::new();
    TextEncoder::new().encode(&registry.gather(), &mut text)?;
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// Every metric has a row of the page's table, with its kind and labels, and every row is one of a metric.
    #[test]
    fn the_page_about_metrics_knows_them_all() {
        let page = include_str!("../../../docs/metrics.md");
        let documented: BTreeSet<String> = page
            .lines()
            .filter_map(|line| line.strip_prefix("| `").filter(|row| row.starts_with("tilecast_")))
            .map(|row| row.split(" | ").take(2).collect::<Vec<_>>().join(" "))
            .collect();
        let told = METRICS.map(|(name, kind, labels, _)| {
            let labels = if labels.is_empty() { String::new() } else { format!("{{{}}}", labels.join(",")) };
            format!("{name}{labels}` {}", if kind == Kind::Counter { "counter" } else { "gauge" })
        });
        assert_eq!(documented, BTreeSet::from(told));
    }

    #[test]
    fn values_are_told_with_help_type_and_escaped_labels() {
        let values: Values = vec![
            ("tilecast_job_samples", owned(&["7", "a \"b\"\nc"]), 12.0),
            ("tilecast_units_total", Vec::new(), 3.0),
        ];
        let text = String::from_utf8(text(&values).unwrap()).unwrap();
        assert!(text.contains("tilecast_job_samples{job=\"7\",name=\"a \\\"b\\\"\\nc\"} 12\n"), "{text}");
        assert!(text.contains("# TYPE tilecast_units_total counter\ntilecast_units_total 3\n"), "{text}");
    }
}

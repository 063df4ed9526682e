//! What deploy/ starts is what the program has: the commands in the chart's rendering, the systemd units and the compose file are
//! run as they stand there, with this machine's folders and addresses, and ports and probes name what is listened on.

use crate::harness::{Folder, Running, free_address, poll};
use std::net::TcpStream;
use std::path::Path;

/// The port that all of deploy/ agrees on.
const PORT: &str = "7878";
/// And the one of health, metrics and the live page.
const HTTP_PORT: &str = "7880";

fn text(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy").join(name);
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// What follows `key` on each of its lines.
fn values<'a>(text: &'a str, key: &str) -> Vec<&'a str> {
    text.lines()
        .filter_map(|line| line.trim_start().trim_start_matches("- ").strip_prefix(key))
        .map(str::trim)
        .collect()
}

/// Lists of words, as YAML and JSON both write them.
fn lists(text: &str, key: &str) -> Vec<Vec<String>> {
    let list = |value: &str| serde_json::from_str(value).unwrap_or_else(|e| panic!("{key} {value}: {e}"));
    values(text, key).into_iter().map(list).collect()
}

/// Starts a coordinator and a worker as `commands` say, and waits until the one has the other.
fn meet(commands: &[Vec<String>]) {
    assert_eq!(commands.len(), 2, "{commands:?}");
    let folder = Folder::new();
    assert_eq!(folder.tilecast(["certs", "init", "certs"]).code, Some(0));
    let (address, http) = (free_address(), free_address());
    let port = address.rsplit_once(':').expect("HOST:PORT").1;
    let here = |words: &[String]| -> Vec<String> {
        let mut words = words.to_vec();
        for i in 1..words.len() {
            words[i] = match words[i - 1].as_str() {
                "--listen" => words[i].replace(PORT, port),
                "--connect" => {
                    let there = if words[i] == "${COORDINATOR}" { "HOST:7878" } else { &words[i] };
                    assert_eq!(there.rsplit_once(':').map(|(_, port)| port), Some(PORT), "{words:?}");
                    address.clone()
                }
                "--http" => {
                    assert_eq!(words[i], format!("0.0.0.0:{HTTP_PORT}"));
                    http.clone()
                }
                "--state" => "state".to_owned(),
                "--certs" => "certs".to_owned(),
                _ => continue,
            };
        }
        words
    };
    let (coordinator, worker): (Vec<_>, Vec<_>) = commands.iter().partition(|words| words[0] == "coordinator");
    assert!(coordinator[0].contains(&format!("0.0.0.0:{PORT}")), "{coordinator:?}");
    let _coordinator: Running = folder.start(here(coordinator[0]));
    poll("the coordinator", || TcpStream::connect(&address).ok());
    if coordinator[0].iter().any(|word| word == "--http") {
        poll("its port for probes", || TcpStream::connect(&http).ok());
    }
    let mut worker = folder.start(here(worker[0]));
    worker.complains("registered");
}

/// Fails if the chart starts the program with a flag that it does not have, or probes a port that nobody listens on.
#[test]
fn the_chart_starts_and_probes_what_there_is() {
    let rendered = text("helm/rendered.yaml");
    meet(&lists(&rendered, "args:"));
    assert_eq!(values(&rendered, "containerPort:"), [PORT, HTTP_PORT]);
    assert_eq!(values(&rendered, "targetPort:"), ["grpc", "http"]);
    // Service and rules for callers name numbers, probes the container's port by name.
    let ports: Vec<&str> = values(&rendered, "port:");
    let count = |port: &str| ports.iter().filter(|&&p| p == port).count();
    assert_eq!((count(PORT), count(HTTP_PORT), count("53"), count("http")), (4, 2, 2, 3), "{ports:?}");
    assert_eq!(ports.len(), 11, "{ports:?}");
    assert_eq!(values(&rendered, "path: /"), ["healthz", "readyz", "healthz"]);
    assert_eq!(values(&rendered, "scheme:"), ["HTTPS"; 3], "with certificates there is no other");
    for probe in ["startupProbe:", "readinessProbe:", "livenessProbe:"] {
        assert_eq!(values(&rendered, probe).len(), 1, "{probe}");
    }
    for (key, value) in
        [("runAsNonRoot:", "true"), ("readOnlyRootFilesystem:", "true"), ("allowPrivilegeEscalation:", "false")]
    {
        assert_eq!(values(&rendered, key), [value, value], "{key}");
    }
    // Each role's files are those that `certs init` makes, and no other's are mounted.
    let mut keys = values(&rendered, "key:");
    keys.sort_unstable();
    assert_eq!(keys, ["ca.pem", "ca.pem", "coordinator.key", "coordinator.pem", "worker.key", "worker.pem"]);
}

#[test]
fn the_rendering_is_of_the_chart_that_is_there() {
    let rendered = text("helm/rendered.yaml");
    // A template's lines without placeholders are in the rendering as they stand.
    for template in ["coordinator", "workers", "network"] {
        for line in
            text(&format!("helm/tilecast/templates/{template}.yaml")).lines().filter(|line| !line.contains("{{"))
        {
            assert!(rendered.contains(line), "run `just chart`: {template}.yaml has `{line}`");
        }
    }
}

#[test]
fn units_and_compose_start_what_there_is() {
    let unit = |name: &str| -> Vec<String> {
        let text = text(&format!("systemd/tilecast-{name}.service"));
        let command = values(&text, "ExecStart=/usr/local/bin/tilecast ")[0].to_owned();
        command.split(' ').map(str::to_owned).collect()
    };
    meet(&[unit("coordinator"), unit("worker")]);
    meet(&lists(&text("compose.yaml"), "command:"));
}

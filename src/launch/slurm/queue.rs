//! Slurm's own programs: `sbatch`, `squeue`, `scancel`. The only file that knows what they print.

use anyhow::{Context, bail};
use std::process::Stdio;
use std::time::Duration;
use tokio::io::AsyncWriteExt;
use tokio::process::Command;

/// A busy controller answers late; one that answers not at all is asked again.
const ANSWER_MAX: Duration = Duration::from_secs(60);
/// Tasks named in one `scancel`; a command line has an end.
const CANCELLED_AT_ONCE_MAX: usize = 500;

/// The tasks of one name.
pub struct Queue {
    name: String,
}

/// One task of an array.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Task {
    /// Number of the array, and of the task in it.
    pub id: (u64, u64),
    /// It does not run yet.
    pub pending: bool,
}

impl Queue {
    /// Those called `name`, of this user.
    pub fn new(name: String) -> Self {
        Self { name }
    }

    /// What waits or runs. Tasks that are about to end do not count.
    pub async fn tasks(&self) -> anyhow::Result<Vec<Task>> {
        let words = ["squeue", "--me", "--array", "--noheader", "--name", &self.name, "--format", "%F %K %t"];
        let said = call(&words.map(str::to_owned), "").await?;
        said.lines().filter_map(|line| parse(line).transpose()).collect()
    }

    /// Submits by `command`; gives the job's number.
    pub async fn submit(&self, command: &[String], script: &str) -> anyhow::Result<u64> {
        let said = call(command, script).await?;
        // NUMBER, or NUMBER;CLUSTER.
        let number = said.trim().split(';').next().unwrap_or_default();
        number.parse().with_context(|| format!("sbatch answered `{}`, which is no job number", said.trim()))
    }

    /// Ends tasks: those that run get SIGTERM, upon which workers hand back what they have.
    pub async fn cancel(&self, tasks: &[Task]) -> anyhow::Result<()> {
        for some in tasks.chunks(CANCELLED_AT_ONCE_MAX) {
            let ids = some.iter().map(|Task { id: (array, task), .. }| format!("{array}_{task}"));
            call(&["scancel".to_owned()].into_iter().chain(ids).collect::<Vec<_>>(), "").await?;
        }
        Ok(())
    }
}

/// `count` of them: those that wait, then the newest.
pub fn newest(mut tasks: Vec<Task>, count: usize) -> Vec<Task> {
    tasks.sort_by_key(|task| std::cmp::Reverse((task.pending, task.id)));
    tasks.truncate(count);
    tasks
}

/// A line of `squeue`: array, task, state.
fn parse(line: &str) -> anyhow::Result<Option<Task>> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let unread = || format!("squeue says `{line}`, where `ARRAY TASK STATE` was asked for");
    let &[array, task, state] = words.as_slice() else { bail!(unread()) };
    let pending = match state {
        // Pending; requeued, on hold or for a special reason.
        "PD" | "RQ" | "RH" | "RS" => true,
        // Configuring, running, suspended, stopped, resizing, signaled.
        "CF" | "R" | "S" | "ST" | "SI" => false,
        _ => return Ok(None),
    };
    let id = (array.parse().with_context(unread)?, task.parse().with_context(unread)?);
    Ok(Some(Task { id, pending }))
}

async fn call(words: &[String], input: &str) -> anyhow::Result<String> {
    let program = &words[0];
    let mut command = Command::new(program);
    command.args(&words[1..]).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).kill_on_drop(true);
    // Ctrl-C is for the launcher, which then still has tasks to cancel.
    #[cfg(unix)]
    command.process_group(0);
    let mut child = command.spawn().with_context(|| {
        format!("`{program}` cannot be started; run this where Slurm's commands are, such as a login node")
    })?;
    if let Some(mut stdin) = child.stdin.take() {
        // A program that does not read its input says why when it ends.
        let _ = stdin.write_all(input.as_bytes()).await;
    }
    let ended = tokio::time::timeout(ANSWER_MAX, child.wait_with_output()).await;
    let output = ended.with_context(|| format!("{program} did not answer within {} s", ANSWER_MAX.as_secs()))??;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        bail!("{program} failed ({}): {}", output.status, said.trim());
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_waits_goes_before_who_works_and_the_newest_before_the_oldest() {
        let said = "7 1 R\n7 2 PD\n9 1 R\n7 3 CG\n";
        let tasks: Vec<Task> = said.lines().filter_map(|line| parse(line).unwrap()).collect();
        assert_eq!(tasks.len(), 3, "a task that ends counts for nothing");
        let ids = |count| newest(tasks.clone(), count).into_iter().map(|task| task.id).collect::<Vec<_>>();
        assert_eq!(ids(2), [(7, 2), (9, 1)]);
        assert!(parse("slurm_load_jobs error").is_err());
        assert!(parse("7 N/A R").is_err());
    }
}

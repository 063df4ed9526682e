//! `tilecast cancel`: ends a job.

use crate::status::state;
use tilecast_proto::client::Client;
use tilecast_proto::transport::Connector;
use tilecast_proto::types::JobId;

/// Which, and whose.
pub struct Cancel {
    /// The coordinator.
    pub connector: Connector,
    /// The job's number.
    pub job: u64,
}

/// Cancels it. A job that has ended stays as it is.
///
/// # Errors
/// Nobody there, or no such job.
pub async fn run(Cancel { connector, job }: Cancel) -> anyhow::Result<()> {
    let progress = Client::connect(&connector).await?.cancel(JobId(job)).await?;
    println!("job {job} is {}", state(&progress.state).0);
    Ok(())
}

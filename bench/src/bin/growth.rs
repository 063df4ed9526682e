//! Rays a second as triangles become more: one mesh, tessellated ever finer, and the same rays against each.

use anyhow::Context;
use clap::Parser;
use std::path::{Path, PathBuf};
use std::time::Instant;
use tilecast_bench::rays::{AllClosest, AllOccluded, bytes, hierarchy, incoherent, primary, torus};
use tilecast_core::bvh::simd::Isa;
use tilecast_core::bvh::{Ray, TriangleBvh};
use tilecast_measure::plot::{Curve, Labels, log_log};

/// Trace the same rays against a mesh of 10^4, 10^5 … triangles on one thread; write growth.csv and growth.svg
#[derive(Parser)]
struct Arguments {
    /// Where the table and the plot go
    #[arg(long, default_value = "docs")]
    out: PathBuf,
    /// The largest mesh has about so many triangles
    #[arg(long, default_value_t = 10_000_000)]
    largest: u32,
    /// Rays of each kind, about
    #[arg(long, default_value_t = 1_000_000)]
    rays: u32,
    /// Times that all are traced, mesh after mesh; the fastest counts
    #[arg(long, default_value_t = 3)]
    passes: u32,
    /// Write the triangles and rays there, too, as the program `rays` reads them
    #[arg(long, value_name = "FOLDER")]
    write: Option<PathBuf>,
}

/// Nanoseconds a ray, the least seen.
struct Times([f64; 2]);

const WHAT: [&str; 2] = ["closest", "any"];

impl Times {
    /// Traces all rays one by one, and many at once: the path loop chooses by the hierarchy's size.
    fn pass(&mut self, mesh: &TriangleBvh, rays: &[Ray]) {
        let isa = Isa::detect();
        let timed = |trace: &dyn Fn() -> usize| {
            let begun = Instant::now();
            let found = trace();
            assert!(found > 0, "rays that hit nothing say nothing");
            begun.elapsed().as_secs_f64() * 1e9 / rays.len() as f64
        };
        for many in [false, true] {
            let closest = timed(&|| isa.dispatch(AllClosest(mesh, rays, many)).0);
            let any = timed(&|| isa.dispatch(AllOccluded(mesh, rays, many)));
            self.0 = [self.0[0].min(closest), self.0[1].min(any)];
        }
    }
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    std::fs::create_dir_all(&arguments.out).with_context(|| format!("making {}", arguments.out.display()))?;
    let side = f64::from(arguments.rays).sqrt() as u32;
    let kinds = [("primary", primary(side)), ("incoherent", incoherent(arguments.rays))];
    if let Some(folder) = &arguments.write {
        std::fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
        for (kind, rays) in &kinds {
            let vectors: Vec<_> = rays.iter().flat_map(|ray| [ray.origin, ray.direction]).collect();
            write(&folder.join(format!("{kind}.rays")), &bytes(&vectors))?;
        }
    }

    let mut meshes = Vec::new();
    let counts = std::iter::successors(Some(10_000_u32), |n| n.checked_mul(10));
    for count in counts.take_while(|&n| n <= arguments.largest) {
        let triangles = torus(count);
        if let Some(folder) = &arguments.write {
            let head = (triangles.len() as u32).to_le_bytes();
            let all = [&head[..], &bytes(triangles.as_flattened())].concat();
            write(&folder.join(format!("torus-{count}.triangles")), &all)?;
        }
        let begun = Instant::now();
        let mesh = hierarchy(&triangles);
        println!("{} triangles: built in {:.2} s", triangles.len(), begun.elapsed().as_secs_f64());
        meshes.push((triangles.len(), mesh, kinds.each_ref().map(|_| Times([f64::INFINITY; 2]))));
    }
    for _ in 0..arguments.passes {
        for (_, mesh, times) in &mut meshes {
            times.iter_mut().zip(&kinds).for_each(|(times, (_, rays))| times.pass(mesh, rays));
        }
    }

    let mut table = String::from("triangles,rays,what,ns_a_ray,mrays_a_second\n");
    let mut curves = Vec::new();
    for (k, (kind, _)) in kinds.iter().enumerate() {
        for (w, what) in WHAT.iter().enumerate() {
            let mut curve = Curve { name: format!("{kind}, {what} hit"), points: Vec::new() };
            for (count, _, times) in &meshes {
                let ns = times[k].0[w];
                table += &format!("{count},{kind},{what},{ns:.1},{:.3}\n", 1e3 / ns);
                curve.points.push((*count as f64, ns));
            }
            curves.push(curve);
        }
    }
    print!("{table}");
    write(&arguments.out.join("growth.csv"), table.as_bytes())?;
    let labels = Labels { title: "A ray's time as triangles become more", x: "triangles", y: "nanoseconds a ray" };
    log_log(&arguments.out.join("growth.svg"), labels, &curves)
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    std::fs::write(path, bytes).with_context(|| format!("writing {}", path.display()))
}

//! Rays per second of the traversal, one thread: `rays TRIANGLES RAYS [--isa NAME] [--hits FILE]`.
//!
//! TRIANGLES: u32 count, then 9 f32 a triangle. RAYS: 6 f32 a ray, origin and direction. FILE: f32 t and u32 triangle a ray
//! (infinite and 0xffffffff where nothing is hit), from another tracer, to compare with. All little endian.

use glam::Vec3;
use std::time::Instant;
use tilecast_bench::rays::{AllClosest, AllOccluded, vectors};
use tilecast_core::bvh::simd::{Isa, Kernel, Lanes};
use tilecast_core::bvh::{Ray, TriangleBvh, TriangleHit};

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let mut files = Vec::new();
    let (mut hits, mut isas) = (None, Isa::available());
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--hits" => hits = Some(args.next().ok_or("--hits needs a file")?),
            "--isa" => {
                let name = args.next().ok_or("--isa needs a name")?;
                let isa = Isa::from_name(&name).filter(|isa| isa.is_available());
                isas = vec![isa.ok_or_else(|| format!("this machine has no path {name}"))?];
            }
            _ => files.push(arg),
        }
    }
    let [triangles, rays] = files.as_slice() else {
        return Err("usage: rays TRIANGLES RAYS [--isa NAME] [--hits FILE]".into());
    };
    let triangles = std::fs::read(triangles)?;
    let vertices: Vec<Vec3> = vectors(triangles.get(4..).unwrap_or_default());
    let rays: Vec<Ray> = vectors(&std::fs::read(rays)?)
        .chunks_exact(2)
        .map(|ray| Ray { origin: ray[0], direction: ray[1], t_max: f32::INFINITY })
        .collect();
    let count = u32::try_from(vertices.len() / 3)?;
    let start = Instant::now();
    let mesh = TriangleBvh::build(count, |i| [0, 1, 2].map(|k| vertices[3 * i as usize + k]));
    let build_s = start.elapsed().as_secs_f64();
    let stats = mesh.stats();
    println!(
        "triangles {count} rays {} build_s {build_s:.3} nodes {} blocks {} bytes/triangle {:.1} sah {:.2}",
        rays.len(),
        stats.nodes,
        stats.blocks,
        stats.bytes as f64 / f64::from(count),
        stats.sah_cost,
    );
    for isa in isas {
        for (many, pass) in [(false, 0), (false, 1), (false, 2), (true, 0), (true, 1), (true, 2)] {
            let start = Instant::now();
            let (found, sum) = isa.dispatch(AllClosest(&mesh, &rays, many));
            let closest = rays.len() as f64 / start.elapsed().as_secs_f64() / 1e6;
            let start = Instant::now();
            let occluded = isa.dispatch(AllOccluded(&mesh, &rays, many));
            let any = rays.len() as f64 / start.elapsed().as_secs_f64() / 1e6;
            println!(
                "{} {} pass {pass} closest_mrays {closest:.3} any_mrays {any:.3} hits {found} occluded {occluded} sum_t {sum:.3}",
                isa.name(),
                if many { "many" } else { "single" },
            );
        }
    }
    hits.map_or(Ok(()), |file| compare(&mesh, &rays, &std::fs::read(file)?))
}

struct One<'a>(&'a TriangleBvh, &'a Ray);

impl Kernel for One<'_> {
    type Output = Option<TriangleHit>;

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) -> Self::Output {
        self.0.closest(lanes, self.1)
    }
}

/// Prints how our hits differ from another tracer's.
fn compare(mesh: &TriangleBvh, rays: &[Ray], theirs: &[u8]) -> Result<(), Failure> {
    let (mut found, mut missed, mut other, mut largest) = (0, 0, 0, 0.0_f64);
    for (ray, hit) in rays.iter().zip(theirs.chunks_exact(8)) {
        let t = f32::from_le_bytes([hit[0], hit[1], hit[2], hit[3]]);
        let triangle = u32::from_le_bytes([hit[4], hit[5], hit[6], hit[7]]);
        match Isa::detect().dispatch(One(mesh, ray)) {
            None if triangle == u32::MAX => {}
            None => missed += 1,
            Some(_) if triangle == u32::MAX => found += 1,
            Some(ours) => {
                let difference = f64::from((ours.t - t).abs()) / f64::from(t);
                largest = largest.max(difference);
                // Neighbours that share the point of the hit are equally right.
                other += usize::from(ours.triangle != triangle && difference > 1e-5);
            }
        }
    }
    println!(
        "only ours {found} only theirs {missed} other triangle {other} largest relative difference of t {largest:.3e}"
    );
    Ok(())
}

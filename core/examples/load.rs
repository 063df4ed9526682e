//! Loads a scene and says what is in it: `cargo run --release --example load -- SCENE [name=value]…`

use std::path::Path;
use tilecast_core::load::{LoadOptions, load};

fn main() -> Result<(), miette::Report> {
    let mut arguments = std::env::args().skip(1);
    let scene = arguments.next().unwrap_or_default();
    let defines = arguments.filter_map(|d| d.split_once('=').map(|(n, v)| (n.to_owned(), v.to_owned()))).collect();
    let start = std::time::Instant::now();
    let loaded = load(Path::new(&scene), &LoadOptions { defines })?;
    let took = start.elapsed();
    let scene = &loaded.scene;
    println!("{:#?}\n{:#?}", scene.sensor, loaded.settings);
    println!("{:#?}\n{:#?}\n{:#?}", scene.textures, scene.bsdfs, scene.emitters);
    for shape in &scene.shapes {
        println!("{shape:?}");
    }
    for note in &loaded.notes {
        println!("note: {note}");
    }
    let triangles: usize = scene.meshes.iter().map(|mesh| mesh.triangles.len()).sum();
    println!("{} shapes, {triangles} triangles, {} images, {took:?}", scene.shapes.len(), scene.images.len());
    Ok(())
}

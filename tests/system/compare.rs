//! Images against images.

use crate::harness::{Folder, SMALL, scene};
use exr::prelude::*;
use serde_json::Value;

/// Two renders of the box, which differ by their seeds alone.
fn two_seeds() -> Folder {
    let folder = Folder::new();
    for (seed, name) in [("1", "a.exr"), ("2", "b.exr")] {
        folder.render(&scene("cornell-box/scene.xml"), ["--size", "48x40", "--spp", "64", "--seed", seed, "-o", name]);
    }
    folder
}

fn compared(folder: &Folder, a: &str, b: &str) -> Value {
    folder.tilecast(["compare", a, b, "--json"]).events().remove(0)
}

#[test]
fn chance_explains_how_seeds_differ_and_not_how_scenes_do() {
    let folder = two_seeds();
    let found = compared(&folder, "a.exr", "b.exr");
    let within = found["ztest"]["within_95"].as_f64().unwrap();
    // Four replicates of 16 samples are not quite normal; 5760 values leave ±0.6 %.
    assert!((0.93..0.98).contains(&within), "{found}");
    assert_eq!(found["bias_interval_from"], "variances");
    assert!(found["bias"].as_array().unwrap().iter().all(|b| b["p"].as_f64() > Some(1e-4)), "{found}");
    assert!(found["relmse"].as_f64() > Some(0.0) && found["flip_hdr"].as_f64() > Some(0.0));

    // Without indirect light it is another picture.
    let more = ["--size", "48x40", "--spp", "64", "--max-depth", "2", "-o", "direct.exr"];
    folder.render(&scene("cornell-box/scene.xml"), more);
    let found = compared(&folder, "direct.exr", "b.exr");
    assert_eq!(found["ztest"]["differs"], true, "{found}");
    assert!(found["bias"][0]["difference"].as_f64() < Some(0.0));

    let outcome = folder.tilecast(["compare", "a.exr", "a.exr", "--difference", "d.png"]);
    assert!(outcome.stdout.contains("chance explains") && outcome.stdout.contains("PSNR    infinite"), "{outcome:?}");
    assert!(folder.names().contains(&"d.png".to_owned()));
}

/// An EXR of these channels, 2 by 1 pixels.
fn write(folder: &Folder, name: &str, channels: &[(&str, f32)]) {
    let channels = channels.iter().map(|&(name, v)| AnyChannel::new(name, FlatSamples::F32(vec![v, 1.0])));
    let channels = AnyChannels::sort(channels.collect());
    let layer = Layer::new((2, 1), LayerAttributes::default(), Encoding::UNCOMPRESSED, channels);
    Image::from_layer(layer).write().to_file(folder.path(name)).unwrap();
}

#[test]
fn what_cannot_be_compared_is_said() {
    let folder = Folder::new();
    folder.render(&scene("cornell-box/scene.xml"), SMALL.iter().chain(&["-o", "a.exr"]));
    write(&folder, "small.exr", &[("R", 0.5), ("G", 0.5), ("B", 0.5)]);
    write(&folder, "nan.exr", &[("R", 0.5), ("G", f32::NAN), ("B", 0.5)]);
    write(&folder, "depth.exr", &[("Z", 0.5), ("R", 1.0)]);
    folder.write("text.exr", "no image");
    for (a, b, part) in [
        ("a.exr", "small.exr", "a.exr has 48x40 pixels and small.exr has 2x1"),
        ("nan.exr", "small.exr", "pixel (0, 0) has the G value NaN"),
        ("small.exr", "depth.exr", "depth.exr"),
        ("small.exr", "text.exr", "text.exr"),
        ("small.exr", "none.exr", "none.exr"),
    ] {
        let outcome = folder.tilecast(["compare", a, b]);
        assert_eq!((outcome.code, outcome.stdout.as_str()), (Some(1), ""), "{outcome:?}");
        assert!(outcome.stderr.contains(part), "{part}: {}", outcome.stderr);
    }
    let outcome = folder.tilecast(["compare", "small.exr", "small.exr"]);
    assert!(outcome.stdout.contains("not possible: no Variance channels in small.exr"), "{outcome:?}");
}

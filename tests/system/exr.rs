//! What is in the written files.

use crate::harness::{Folder, SMALL, scene};
use exr::prelude::{AttributeValue, FlatImage, FlatSamples, Text, Vec2};
use std::path::Path;

pub fn read(path: &Path) -> FlatImage {
    exr::prelude::read_all_flat_layers_from_file(path).expect("an OpenEXR file")
}

/// The bits of a channel, row by row.
pub fn channel(image: &FlatImage, name: &str) -> Vec<u32> {
    let channels = &image.layer_data[0].channel_data.list;
    let found = channels.iter().find(|channel| channel.name == *name).unwrap_or_else(|| panic!("no channel {name}"));
    match &found.sample_data {
        FlatSamples::F32(values) => values.iter().map(|value| value.to_bits()).collect(),
        other => panic!("{name} is {other:?}"),
    }
}

fn text(image: &FlatImage, name: &str) -> String {
    match image.layer_data[0].attributes.other.get(&Text::from(name)) {
        Some(AttributeValue::Text(text)) => text.to_string(),
        other => panic!("{name} is {other:?}"),
    }
}

#[test]
fn channels_are_named_as_pbrt_names_them() {
    let folder = Folder::new();
    folder.render(&scene("cornell-box/scene.xml"), SMALL);
    let image = read(&folder.path("scene.exr"));
    let names: Vec<String> = image.layer_data[0].channel_data.list.iter().map(|c| c.name.to_string()).collect();
    assert_eq!(names, ["B", "G", "R", "SampleCount", "Variance.B", "Variance.G", "Variance.R"]);
    assert!(channel(&image, "SampleCount").iter().all(|&bits| f32::from_bits(bits) == 6.0));
    for name in ["R", "G", "B", "Variance.R", "Variance.G", "Variance.B"] {
        let values: Vec<f32> = channel(&image, name).into_iter().map(f32::from_bits).collect();
        assert_eq!(values.len(), 48 * 40);
        assert!(values.iter().all(|v| v.is_finite() && *v >= 0.0), "{name}");
        assert!(values.iter().any(|v| *v > 0.0), "{name}");
    }
}

#[test]
fn attributes_say_what_renders_it_again() {
    let folder = Folder::new();
    let finished = folder.render(&scene("cornell-box/scene.xml"), SMALL.iter().chain(&["--seed", "7", "-o", "a.exr"]));
    let image = read(&folder.path("a.exr"));
    assert_eq!(text(&image, "tilecast:digest"), finished["digest"].as_str().unwrap());
    assert_eq!(text(&image, "tilecast:samples"), "0..6");
    assert_eq!(text(&image, "tilecast:seed"), "7");
    assert_eq!(text(&image, "tilecast:engine"), tilecast_core::VERSION);
    assert_eq!(text(&image, "tilecast:scene").len(), 64);
    let settings: tilecast_core::settings::Settings = serde_json::from_str(&text(&image, "tilecast:settings")).unwrap();
    assert_eq!((settings.spp, settings.seed, settings.film.width, settings.film.height), (6, 7, 48, 40));
}

#[test]
fn equal_renders_are_equal_files() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    for (name, threads) in [("a.exr", "1"), ("b.exr", "2"), ("c.exr", "1")] {
        folder.render(&scene, SMALL.iter().chain(&["-o", name, "--threads", threads]));
    }
    let bytes = ["a.exr", "b.exr", "c.exr"].map(|name| std::fs::read(folder.path(name)).unwrap());
    assert!(bytes[0] == bytes[1] && bytes[1] == bytes[2]);
}

#[test]
fn a_crop_has_the_bits_of_the_whole() {
    let folder = Folder::new();
    let scene = scene("cornell-box/scene.xml");
    folder.render(&scene, SMALL.iter().chain(&["-o", "whole.exr"]));
    folder.render(&scene, SMALL.iter().chain(&["-o", "part.exr", "--crop", "5,9,31,22"]));
    let (whole, part) = (read(&folder.path("whole.exr")), read(&folder.path("part.exr")));
    let layer = &part.layer_data[0];
    assert_eq!((layer.attributes.layer_position, layer.size), (Vec2(5, 9), Vec2(26, 13)));
    assert_eq!(part.attributes.display_window.size, Vec2(48, 40));
    assert_eq!(part.attributes.display_window.position, Vec2(0, 0));
    for name in ["R", "G", "B", "Variance.R", "Variance.G", "Variance.B", "SampleCount"] {
        let (whole, part) = (channel(&whole, name), channel(&part, name));
        for (y, row) in part.chunks(26).enumerate() {
            let start = (y + 9) * 48 + 5;
            assert_eq!(row, &whole[start..start + 26], "{name}, row {y}");
        }
    }
}

#[test]
fn a_preview_is_a_picture_of_the_same_size() {
    let folder = Folder::new();
    folder.render(&scene("cornell-box/scene.xml"), SMALL.iter().chain(&["--preview", "--no-film", "-o", "a.exr"]));
    assert_eq!(folder.names(), ["a.exr", "a.png"]);
    let picture = image::open(folder.path("a.png")).unwrap().into_rgb8();
    assert_eq!(picture.dimensions(), (48, 40));
    // The left wall is red and the right one green; the picture is wider than the box, which begins at column 4.
    let sum = |x0: u32, channel: usize| {
        let columns = (x0..x0 + 4).flat_map(|x| (10..30).map(move |y| (x, y)));
        columns.map(|(x, y)| u32::from(picture.get_pixel(x, y).0[channel])).sum::<u32>()
    };
    assert!(sum(6, 0) > 2 * sum(6, 1) && sum(38, 1) > sum(38, 0));
}

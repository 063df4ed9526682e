//! The viewer tev, played by a listener that reads its protocol and takes nothing else: it has the image that is written, and
//! whatever it does, the render does not wait.

use crate::exr::{channel, read};
use crate::harness::{Folder, Running, free_address, scene};
use std::collections::BTreeMap;
use std::io::Read;
use std::net::{TcpListener, TcpStream};

/// An image as the viewer has it: width, and its channels.
#[derive(Default)]
struct Image {
    width: usize,
    channels: BTreeMap<String, Vec<u32>>,
    updates: usize,
}

/// The bytes of one frame, taken one after the other.
struct Frame(Vec<u8>, usize);

impl Frame {
    /// The next one; `None` where the connection ends between two.
    fn read(stream: &mut TcpStream) -> Option<Self> {
        let mut len = [0; 4];
        stream.read_exact(&mut len).ok()?;
        let len = u32::from_le_bytes(len) as usize;
        assert!((5..4 << 20).contains(&len), "a frame of {len} bytes");
        let mut bytes = vec![0; len - 4];
        stream.read_exact(&mut bytes).expect("whole frames");
        Some(Self(bytes, 0))
    }

    fn take<const N: usize>(&mut self) -> [u8; N] {
        self.1 += N;
        self.0[self.1 - N..self.1].try_into().expect("as many bytes")
    }

    fn number(&mut self) -> usize {
        usize::try_from(i32::from_le_bytes(self.take())).expect("not negative")
    }

    fn long(&mut self) -> usize {
        usize::try_from(i64::from_le_bytes(self.take())).expect("not negative")
    }

    fn flag(&mut self) -> bool {
        let [flag] = self.take();
        assert!(flag < 2, "a bool is 0 or 1");
        flag == 1
    }

    fn text(&mut self) -> String {
        let end = self.0[self.1..].iter().position(|&byte| byte == 0).expect("a zero");
        let text = String::from_utf8(self.0[self.1..self.1 + end].to_vec()).expect("UTF-8");
        self.1 += end + 1;
        text
    }

    fn texts(&mut self) -> Vec<String> {
        (0..self.number()).map(|_| self.text()).collect()
    }

    fn floats(&mut self) -> Vec<u32> {
        let rest = self.0.split_off(self.1);
        assert_eq!(rest.len() % 4, 0, "whole floats to the frame's end");
        rest.chunks(4).map(|four| u32::from_le_bytes(four.try_into().expect("four bytes"))).collect()
    }
}

/// Reads frames until the connection ends, or `frames_max` of them.
fn watch(stream: &mut TcpStream, frames_max: usize) -> BTreeMap<String, Image> {
    let mut images = BTreeMap::<String, Image>::new();
    for _ in 0..frames_max {
        let Some(mut frame) = Frame::read(stream) else { break };
        match frame.take() {
            [4] => {
                assert!(frame.flag(), "a new image is to be looked at");
                let name = frame.text();
                let (width, height) = (frame.number(), frame.number());
                let channels = frame.texts().into_iter().map(|name| (name, vec![0; width * height])).collect();
                assert_eq!(frame.1, frame.0.len(), "nothing behind a Create");
                images.insert(name, Image { width, channels, updates: 0 });
            }
            [6] => {
                assert!(!frame.flag(), "an update takes nobody's attention");
                let image = images.get_mut(&frame.text()).expect("created before");
                let names = frame.texts();
                let [x, y, w, h] = [(); 4].map(|()| frame.number());
                let offsets: Vec<usize> = names.iter().map(|_| frame.long()).collect();
                let strides: Vec<usize> = names.iter().map(|_| frame.long()).collect();
                let data = frame.floats();
                let last = offsets.iter().zip(&strides).map(|(offset, stride)| offset + (w * h - 1) * stride).max();
                assert_eq!(last.map(|last| last + 1), Some(data.len()), "all of the data and no more");
                for ((name, offset), stride) in names.iter().zip(&offsets).zip(&strides) {
                    let pixels = image.channels.get_mut(name).expect("a channel of the image");
                    for i in 0..w * h {
                        pixels[(y + i / w) * image.width + x + i % w] = data[offset + i * stride];
                    }
                }
                image.updates += 1;
            }
            other => panic!("operation {other:?}"),
        }
    }
    images
}

fn listener() -> (TcpListener, String) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("an address").to_string();
    (listener, address)
}

fn render(folder: &Folder, tev: &str, size: &str, spp: &str) -> Running {
    let box_ = scene("cornell-box/scene.xml");
    folder.start(["render", &box_, "--tile", "16", "--size", size, "--spp", spp, "--json", "--tev", tev])
}

/// The image that was written, as a viewer would have it.
fn written(folder: &Folder) -> BTreeMap<String, Vec<u32>> {
    let image = read(&folder.path("scene.exr"));
    let mean = |name: &str| (name.to_owned(), channel(&image, name));
    let error = |name: &str| {
        let variance = channel(&image, &format!("Variance.{name}"));
        let sigma = variance.into_iter().map(|bits| f32::from_bits(bits).sqrt().to_bits()).collect();
        (format!("error.{name}"), sigma)
    };
    ["R", "G", "B"].into_iter().flat_map(|name| [mean(name), error(name)]).collect()
}

/// Planted faults: strides before offsets, a length without itself, a tile told twice and another never.
#[test]
fn a_viewer_has_the_image_that_is_written() {
    let (folder, (listener, address)) = (Folder::new(), listener());
    let render = render(&folder, &address, "48x40", "200");
    let images = watch(&mut listener.accept().expect("it connects").0, usize::MAX);
    render.end().finished();
    assert_eq!(images.keys().collect::<Vec<_>>(), ["tilecast 1"]);
    assert_eq!(images["tilecast 1"].channels, written(&folder));
}

#[test]
fn a_viewer_that_is_started_again_has_all_of_it_again() {
    let (folder, (listener, address)) = (Folder::new(), listener());
    let render = render(&folder, &address, "48x40", "8000");
    let first = watch(&mut listener.accept().expect("it connects").0, 4);
    assert_eq!(first["tilecast 1"].updates, 3);
    let images = watch(&mut listener.accept().expect("it connects again").0, usize::MAX);
    render.end().finished();
    assert_eq!(images["tilecast 1"].channels, written(&folder));
}

/// One that is not there, and one that takes nothing: the image is the same, and the end comes by itself.
#[test]
fn a_viewer_that_is_absent_or_stalled_changes_nothing() {
    let folder = Folder::new();
    let alone = folder.render(&scene("cornell-box/scene.xml"), ["--size", "192x192", "--spp", "64"]);
    let (stalled, address) = listener();
    for viewer in [free_address(), address] {
        let finished = render(&folder, &viewer, "192x192", "64").end().finished();
        assert_eq!(finished["digest"], alone["digest"]);
    }
    drop(stalled);
    let wrong = folder.tilecast(["render", "scene.xml", "--tev", ":1"]);
    assert_eq!(wrong.code, Some(2), "{wrong:?}");
}

//! The command that replays a sample, made of the command that met it.

/// What `render` knows nothing of, each with a value.
const NOT_OF_RENDER: [&str; 1] = ["--connect"];
/// What writes images or JSON, which a replay does not; the flag and whether a value follows it.
const NOT_OF_REPLAY: [(&str, bool); 4] = [("-o", true), ("--output", true), ("--preview", false), ("--json", false)];

/// `tilecast render` with all that `args` say of the picture, ready for `--pixel X,Y --sample I` to follow.
pub fn command(args: impl IntoIterator<Item = String>) -> String {
    let mut words = vec!["tilecast".to_owned(), "render".to_owned()];
    let mut args = args.into_iter().skip(2);
    while let Some(arg) = args.next() {
        let name = arg.split_once('=').map_or(arg.as_str(), |(name, _)| name);
        let dropped = NOT_OF_REPLAY.iter().find(|(flag, _)| *flag == name).map(|&(_, value)| value);
        match dropped.or_else(|| NOT_OF_RENDER.contains(&name).then_some(true)) {
            Some(true) if name == arg => drop(args.next()),
            Some(_) => {}
            None if arg.starts_with("-o") => {}
            None => words.push(quoted(&arg)),
        }
    }
    words.join(" ")
}

/// A word as a POSIX shell reads it.
pub fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_=./,:+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_part_of_the_picture_is_left_out() {
        let of = |line: &[&str]| command(line.iter().map(|&word| word.to_owned()));
        let line =
            ["/bin/tilecast", "submit", "a b.xml", "--connect", "h:1", "-D", "x=1", "-o", "o.exr", "-oo.exr", "--json"];
        assert_eq!(of(&line), "tilecast render 'a b.xml' -D x=1");
        assert_eq!(of(&["tilecast", "render", "--output=o", "it's", "--spp=4"]), r"tilecast render 'it'\''s' --spp=4");
    }
}

//! What can go wrong with files: one paragraph that says where, what and what to do, and the line it happened on.
//!
//! Knows nothing of any format. Messages are written where the fault is found; this file only carries them and shows them.

use miette::{Diagnostic, LabeledSpan, MietteError, MietteSpanContents, SourceCode, SourceSpan, SpanContents};
use std::fmt;
use std::ops::Range;

/// A scene that cannot be loaded. Shown by `Display` as one paragraph (`file:line:column: what, and what to do`); as a
/// [`miette::Diagnostic`] also with the line of the file.
#[derive(Clone, Debug)]
pub struct LoadError(Box<Fault>);

#[derive(Clone, Debug)]
struct Fault {
    message: String,
    place: Option<Place>,
}

/// A result of loading.
pub(crate) type Result<T> = std::result::Result<T, LoadError>;

/// A position in a text file, with the line it lies on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Place {
    /// The file, named as the user would open it.
    file: String,
    /// From 1, with column and text of the line, where there is a line.
    line: Option<Line>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct Line {
    /// From 1.
    number: usize,
    /// From 1, in characters.
    column: usize,
    /// The line, or what of it is worth showing.
    text: String,
    /// Bytes of `text` that are at fault.
    marked: Range<usize>,
}

/// Bytes of a line shown before and behind the fault: some scenes have lines of megabytes.
const SHOWN_BEFORE: usize = 60;
const SHOWN_BEHIND: usize = 120;

impl Place {
    /// A whole file.
    pub fn file(file: impl Into<String>) -> Self {
        Self { file: file.into(), line: None }
    }

    /// Line `number` (from 1) of a file, which reads `text`.
    pub fn on_line(file: impl Into<String>, number: usize, text: &str) -> Self {
        let indent = text.len() - text.trim_start().len();
        Self { file: file.into(), line: Some(Line::new(number, text, indent, text.trim().len())) }
    }

    /// The file's name and line, for notes.
    pub fn file_and_line(&self) -> (&str, Option<usize>) {
        (&self.file, self.line.as_ref().map(|line| line.number))
    }
}

/// The text of a file and where its lines are: scenes of many thousand objects ask for the place of each.
#[derive(Debug)]
pub(crate) struct SourceText {
    /// The file, named as the user would open it.
    name: String,
    text: String,
    /// Ascending; the first is 0.
    line_starts: Vec<usize>,
}

impl SourceText {
    pub fn new(name: impl Into<String>, text: impl Into<String>) -> Self {
        let text = text.into();
        let line_starts = std::iter::once(0).chain(text.match_indices('\n').map(|(i, _)| i + 1)).collect();
        Self { name: name.into(), text, line_starts }
    }

    /// Line and column, in characters, from 1.
    pub fn at(&self, line: usize, column: usize) -> Place {
        let start = self.line_starts[line.clamp(1, self.line_starts.len()) - 1];
        let before = self.text[start..].chars().take(column.saturating_sub(1));
        let at = start + before.map(char::len_utf8).sum::<usize>();
        self.place(at..at + 1)
    }

    /// Where the bytes `range` are.
    pub fn place(&self, range: Range<usize>) -> Place {
        let at = floor_boundary(&self.text, range.start);
        let number = self.line_starts.partition_point(|&start| start <= at);
        let start = self.line_starts[number - 1];
        let end = self.line_starts.get(number).map_or(self.text.len(), |next| next - 1);
        let line = Line::new(number, &self.text[start..end], at - start, range.len());
        Place { file: self.name.clone(), line: Some(line) }
    }
}

impl Line {
    /// Clips `text` around the `len` bytes from `start`.
    fn new(number: usize, text: &str, start: usize, len: usize) -> Self {
        let text = text.trim_end_matches('\r');
        let start = floor_boundary(text, start);
        let column = text[..start].chars().count() + 1;
        let from = floor_boundary(text, start.saturating_sub(SHOWN_BEFORE));
        let to = floor_boundary(text, text.len().min(start + SHOWN_BEHIND));
        let marked_end = floor_boundary(text, start.saturating_add(len)).clamp(start, to);
        Self { number, column, text: text[from..to].to_owned(), marked: start - from..marked_end - from }
    }
}

/// The largest character boundary of `text` that is not beyond `at`.
fn floor_boundary(text: &str, at: usize) -> usize {
    let mut at = at.min(text.len());
    while !text.is_char_boundary(at) {
        at -= 1;
    }
    at
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.line {
            Some(line) => write!(f, "{}:{}:{}", self.file, line.number, line.column),
            None => f.write_str(&self.file),
        }
    }
}

impl LoadError {
    /// An error that concerns no file.
    pub(crate) fn new(message: impl Into<String>) -> Self {
        Self(Box::new(Fault { message: message.into(), place: None }))
    }

    /// An error at a place.
    pub(crate) fn at(place: Place, message: impl Into<String>) -> Self {
        Self(Box::new(Fault { message: message.into(), place: Some(place) }))
    }

    /// What is wrong and what to do, without the place.
    pub fn message(&self) -> &str {
        &self.0.message
    }

    fn line(&self) -> Option<&Line> {
        self.0.place.as_ref()?.line.as_ref()
    }
}

impl fmt::Display for LoadError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.0.place {
            Some(place) => write!(f, "{place}: {}", self.0.message),
            None => f.write_str(&self.0.message),
        }
    }
}

impl std::error::Error for LoadError {}

impl Diagnostic for LoadError {
    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.line()?;
        self.0.place.as_ref().map(|place| place as &dyn SourceCode)
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        let marked = self.line()?.marked.clone();
        Some(Box::new(std::iter::once(LabeledSpan::new(Some("here".into()), marked.start, marked.len()))))
    }
}

/// The one line that is kept of the file; it is always shown whole.
impl SourceCode for Place {
    fn read_span<'a>(
        &'a self,
        span: &SourceSpan,
        _lines_before: usize,
        _lines_after: usize,
    ) -> std::result::Result<Box<dyn SpanContents<'a> + 'a>, MietteError> {
        let line = self.line.as_ref().ok_or(MietteError::OutOfBounds)?;
        if span.offset() + span.len() > line.text.len() {
            return Err(MietteError::OutOfBounds);
        }
        let whole = SourceSpan::from((0, line.text.len()));
        let contents = MietteSpanContents::new_named(
            self.file.clone(),
            line.text.as_bytes(),
            whole,
            line.number - 1,
            line.column - 1,
            1,
        );
        Ok(Box::new(contents))
    }
}

/// `; did you mean 'x'?` with the known name nearest to a wrong one, or nothing if none is near.
pub(crate) fn did_you_mean<'a>(wrong: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    nearest(wrong, known).map_or_else(String::new, |name| format!("; did you mean '{name}'?"))
}

/// The known name nearest to a wrong one by edit distance, if it is near enough to be meant: a third of its letters, or
/// one wrong letter.
fn nearest<'a>(wrong: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let wrong: String = wrong.chars().take(NAME_LENGTH_MAX).flat_map(char::to_lowercase).collect();
    known
        .into_iter()
        .filter(|name| name.len() <= NAME_LENGTH_MAX)
        .map(|name| (edit_distance(&wrong, &name.to_lowercase()), name))
        .filter(|(distance, name)| *distance <= (name.chars().count() / 3).max(1))
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, name)| name)
}

/// Longer names are no names anyone mistyped; the edit distance takes time quadratic in it.
const NAME_LENGTH_MAX: usize = 100;

/// Insertions, deletions, substitutions and swaps of neighbours that turn `a` into `b` (optimal string alignment).
fn edit_distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    let mut rows: Vec<Vec<usize>> = vec![(0..=b.len()).collect()];
    for i in 1..=a.len() {
        let mut row = vec![i];
        for j in 1..=b.len() {
            let same = a[i - 1] == b[j - 1];
            let mut cost = (rows[i - 1][j] + 1).min(row[j - 1] + 1).min(rows[i - 1][j - 1] + usize::from(!same));
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                cost = cost.min(rows[i - 2][j - 2] + 1);
            }
            row.push(cost);
        }
        rows.push(row);
    }
    rows[a.len()][b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_counts_lines_and_characters_from_one() {
        let text = "one\nzwölf drei\nend";
        let place = SourceText::new("a.xml", text).place(11..15);
        assert_eq!(place.to_string(), "a.xml:2:7");
        let line = place.line.unwrap();
        assert_eq!(&line.text[line.marked], "drei");
    }

    #[test]
    fn every_place_has_a_line() {
        let text = SourceText::new("a.xml", "ab\n\ncd\n");
        let seen: Vec<String> = [0, 1, 2, 3, 4, 5, 6, 7, 99].map(|at| text.place(at..at).to_string()).into();
        let expected = ["1:1", "1:2", "1:3", "2:1", "3:1", "3:2", "3:3", "4:1", "4:1"];
        assert_eq!(seen, expected.map(|at| format!("a.xml:{at}")));
        assert_eq!(text.at(3, 2), text.place(5..6));
        assert_eq!(SourceText::new("a.xml", "").place(0..5).to_string(), "a.xml:1:1");
    }

    #[test]
    fn a_long_line_is_clipped_around_the_fault() {
        let text = format!("{}FAULT{}", "ä".repeat(1000), "b".repeat(1000));
        let line = SourceText::new("a.xml", text).place(2000..2005).line.unwrap();
        assert_eq!(line.column, 1001);
        assert_eq!(&line.text[line.marked], "FAULT");
        assert!(line.text.len() <= SHOWN_BEFORE + SHOWN_BEHIND);
    }

    #[test]
    fn the_report_shows_file_line_and_text() {
        let place = SourceText::new("a.xml", "x\n<bsdf type='difuse'/>\n").place(13..19);
        let error = LoadError::at(place, "no such thing");
        let handler = miette::GraphicalReportHandler::new_themed(miette::GraphicalTheme::none());
        let mut shown = String::new();
        handler.render_report(&mut shown, &error).unwrap();
        assert!(shown.contains("no such thing") && shown.contains("a.xml:2:12"), "{shown}");
        assert!(shown.contains("2 │ <bsdf type='difuse'/>") || shown.contains("2 | <bsdf type='difuse'/>"), "{shown}");
    }

    #[test]
    fn near_names_are_found_and_far_ones_are_not() {
        assert_eq!(nearest("difuse", ["dielectric", "diffuse"]), Some("diffuse"));
        assert_eq!(nearest("toWorld", ["to_world"]), Some("to_world"));
        assert_eq!(nearest("elephant", ["diffuse", "mask"]), None);
        assert_eq!(edit_distance("ab", "ba"), 1);
        assert_eq!(edit_distance("", "abc"), 3);
    }
}

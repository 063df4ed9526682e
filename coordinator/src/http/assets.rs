//! The page: files that are part of the program. It asks nothing of any other host.

use super::Inner;
use axum::Router;
use axum::http::header;
use axum::routing::get;
use std::sync::Arc;

/// Path, type and content.
pub const ASSETS: [(&str, &str, &[u8]); 8] = [
    ("/", "text/html; charset=utf-8", include_bytes!("page/index.html")),
    ("/style.css", "text/css; charset=utf-8", include_bytes!("page/style.css")),
    ("/main.js", "text/javascript; charset=utf-8", include_bytes!("page/main.js")),
    ("/image.js", "text/javascript; charset=utf-8", include_bytes!("page/image.js")),
    ("/tables.js", "text/javascript; charset=utf-8", include_bytes!("page/tables.js")),
    ("/plot.js", "text/javascript; charset=utf-8", include_bytes!("page/plot.js")),
    ("/uplot.js", "text/javascript; charset=utf-8", include_bytes!("page/uplot/uPlot.iife.min.js")),
    ("/uplot.css", "text/css; charset=utf-8", include_bytes!("page/uplot/uPlot.min.css")),
];

/// What the page weighs at most.
#[cfg(test)]
const BYTES_MAX: usize = 300_000;

/// Routes to all of them.
pub fn routes() -> Router<Arc<Inner>> {
    let icon = get(|| async { ([(header::CONTENT_TYPE, "image/svg+xml")], &include_bytes!("page/icon.svg")[..]) });
    ASSETS.iter().fold(Router::new().route("/icon.svg", icon), |router, &(path, kind, bytes)| {
        // A newer program may have a newer page at the same address.
        let headers = [(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, "no-cache")];
        router.route(path, get(move || async move { (headers, bytes) }))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_small_and_names_nothing_elsewhere() {
        let bytes: usize = ASSETS.iter().map(|(_, _, bytes)| bytes.len()).sum();
        assert!(bytes <= BYTES_MAX, "{bytes} bytes");
        for (path, _, bytes) in ASSETS.iter().filter(|(path, ..)| !path.starts_with("/uplot")) {
            let text = String::from_utf8_lossy(bytes);
            assert!(!text.contains("://"), "{path}");
        }
    }
}

//! One page with clouds, keypoints and surfaces: markup, style, script and data in a single file.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};
use snake_core::Options;
use snake_geometry::printable;

use crate::pair::ShownPair;
use crate::shown_cloud::ShownCloud;

const BODY: &str = include_str!("page_parts/body.html");
const STYLE: &str = include_str!("page_parts/style.css");
const SCRIPTS: [&str; 2] = [include_str!("page_parts/scene.js"), include_str!("page_parts/controls.js")];

/// The content of the page.
pub struct Page {
    /// One or two clouds.
    pub clouds: Vec<ShownCloud>,
    /// Present if there are two clouds.
    pub pair: Option<ShownPair>,
    /// The options of the detection.
    pub options: Options,
    /// The name of the model.
    pub model_name: String,
    /// Colours, red, green and blue, for saliency from 0 to 1.
    pub colors: [[u8; 3]; 256],
}

/// The colour map viridis.
pub fn viridis() -> [[u8; 3]; 256] {
    std::array::from_fn(|i| colorous::VIRIDIS.eval_rational(i, 256).into_array())
}

impl Page {
    /// The content of the HTML file.
    ///
    /// # Errors
    /// No error is known: all values can be written as JSON.
    pub fn html(&self) -> serde_json::Result<String> {
        let names: Vec<&str> = self.clouds.iter().map(|cloud| cloud.name.as_str()).collect();
        Ok(document(&format!("{}: keypoints", names.join(" + ")), &self.data()))
    }

    fn data(&self) -> Value {
        let clouds: Vec<Value> = self.clouds.iter().map(ShownCloud::data).collect();
        json!({
            "clouds": clouds,
            "pair": self.pair.as_ref().map(ShownPair::data),
            "colors": STANDARD.encode(self.colors.as_flattened()),
            "options": self.options,
            "model": self.model_name,
            "version": env!("CARGO_PKG_VERSION"),
        })
    }
}

/// A page with markup, style and scripts around its data.
pub(crate) fn document(title: &str, data: &Value) -> String {
    let (title, script) = (escaped(&printable(title)), SCRIPTS.join("\n"));
    // Only "<" could end the script element or begin a comment in it.
    let data = data.to_string().replace('<', "\\u003c");
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; \
         script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:\">\n\
         <link rel=\"icon\" href=\"data:,\">\n<title>{title}</title>\n\
         <style>\n{STYLE}</style>\n</head>\n<body>\n{BODY}\
         <script type=\"application/json\" id=\"data\">{data}</script>\n<script>\n{script}</script>\n\
         </body>\n</html>\n"
    )
}

/// Text with the special characters of HTML escaped.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_title_has_no_control_characters() {
        let page = document("a\u{1b}]0;b\u{7}\u{202e}<c>", &Value::Null);
        assert!(page.contains("<title>a\\u{1b}]0;b\\u{7}\\u{202e}&lt;c&gt;</title>"));
    }

    #[test]
    fn text_cannot_become_markup() {
        assert_eq!(escaped("<a href=\"&\">"), "&lt;a href=&quot;&amp;&quot;&gt;");
    }
}

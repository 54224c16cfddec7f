//! What an image file says of its making: the settings that define it, nothing of how or where it was run.

use crate::render::metric::ErrorReached;
use crate::settings::ImageSettings;

/// The estimated error of an image, as it is stored in it.
pub fn describe_error(error: &ErrorReached) -> Vec<(String, String)> {
    [
        ("error_rmse", error.rmse),
        ("error_rmse_at_most", error.rmse_at_most),
        ("error_relmse", error.rel_mse),
        ("error_relmse_at_most", error.rel_mse_at_most),
        ("mean_spp", error.spp),
    ]
    .map(|(key, value)| (key.to_owned(), format!("{value:e}")))
    .into()
}

/// Key and value of each image-defining setting, and the program's version.
pub fn describe(image: &ImageSettings) -> Vec<(String, String)> {
    let name = |value: &dyn std::fmt::Debug| format!("{value:?}").to_lowercase();
    let crop = image.crop;
    [
        ("Software", format!("heliostat {}", env!("CARGO_PKG_VERSION"))),
        ("width", image.width.to_string()),
        ("height", image.height.to_string()),
        ("crop", format!("{},{},{},{}", crop.x0, crop.y0, crop.x1, crop.y1)),
        ("spp", image.spp.to_string()),
        ("seed", image.seed.to_string()),
        ("integrator", name(&image.integrator)),
        ("max_depth", image.max_depth.to_string()),
        ("min_weight", image.min_weight.to_string()),
        ("roulette", image.roulette.to_string()),
        ("direct", name(&image.direct)),
        ("sampler", name(&image.sampler)),
        ("filter", name(&image.filter)),
        ("encoding", name(&image.encoding)),
        ("show", name(&image.show)),
    ]
    .map(|(key, value)| (key.to_owned(), value))
    .into_iter()
    .chain(
        image.error_target.map(|target| {
            ("error_target".to_owned(), format!("{} {:e}", name(&target.metric), target.value))
        }),
    )
    .collect()
}

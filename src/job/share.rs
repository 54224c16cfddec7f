//! What every rank holds in the replicated splits, and its way there from rank 0.

use super::partition::Division;
use crate::accel::Accel;
use crate::cluster::Comm;
use crate::cluster::share::Share;
use crate::error::Result;
use crate::scene::{Scene, Texture};
use crate::settings::{ImageSettings, RunSettings, Split};

/// The whole work of a render: scene, accelerator and settings.
#[derive(Clone, Debug)]
pub struct Work {
    pub scene: Scene,
    pub accel: Accel,
    pub image: ImageSettings,
    pub run: RunSettings,
    /// Where `scene` and `accel` are this rank's part only.
    pub division: Option<Division>,
}

impl Default for Work {
    /// An empty shell, to be filled by [`Work::share`].
    fn default() -> Self {
        Work {
            scene: Scene::default(),
            accel: Accel::Brute,
            image: ImageSettings::default(),
            run: RunSettings::default(),
            division: None,
        }
    }
}

impl Work {
    /// Collective: all ranks get rank 0's work. Small things first, then the arrays as their bytes lie.
    pub fn share(&mut self, share: Share) -> Result<()> {
        share.value(&mut self.image)?;
        share.value(&mut self.run)?;
        share_scene(&mut self.scene, share)?;
        if self.accel.kind() != self.run.accel {
            self.accel = Accel::empty(self.run.accel);
        }
        match &mut self.accel {
            Accel::Brute => Ok(()),
            Accel::Bvh(wide) => {
                share.value(&mut wide.low)?;
                share.value(&mut wide.high)?;
                share.value(&mut wide.tree.stack_size)?;
                share.array(&mut wide.tree.nodes)?;
                share.array(&mut wide.tree.blocks)
            }
            Accel::Grid(grid) => {
                share.value(&mut grid.lattice)?;
                share.array(&mut grid.starts)?;
                share.array(&mut grid.primitives)?;
                share.array(&mut grid.occupied)
            }
        }
    }
}

/// Collective: rank 0's split on every rank, before anything else of the work is there.
pub(super) fn agreed_split(comm: &dyn Comm, split: Split) -> Result<Split> {
    crate::cluster::share::computed(comm, || Ok(split))
}

fn share_scene(scene: &mut Scene, share: Share) -> Result<()> {
    share.value(&mut scene.header)?;
    let surfaces = &mut scene.surfaces;
    share.array(&mut surfaces.positions)?;
    share.array(&mut surfaces.triangles)?;
    share.array(&mut surfaces.spheres)?;
    share.array(&mut surfaces.normals)?;
    share.array(&mut surfaces.uvs)?;
    share.array(&mut surfaces.colors)?;
    let mut sizes: Vec<(u32, u32)> = scene.textures.iter().map(|t| (t.width, t.height)).collect();
    share.value(&mut sizes)?;
    scene.textures.resize_with(sizes.len(), Texture::default);
    for (texture, (width, height)) in scene.textures.iter_mut().zip(sizes) {
        (texture.width, texture.height) = (width, height);
        share.array(&mut texture.texels)?;
    }
    Ok(())
}

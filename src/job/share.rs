//! What every rank holds in the replicated splits, and its way there from rank 0.

use crate::accel::Accel;
use crate::cluster::share::Share;
use crate::error::Result;
use crate::scene::{Scene, Texture};
use crate::settings::{ImageSettings, RunSettings};

/// The whole work of a render: scene, accelerator and settings.
#[derive(Clone, Debug)]
pub struct Work {
    pub scene: Scene,
    pub accel: Accel,
    pub image: ImageSettings,
    pub run: RunSettings,
}

impl Default for Work {
    /// An empty shell, to be filled by [`Work::share`].
    fn default() -> Self {
        Work {
            scene: Scene::default(),
            accel: Accel::Brute,
            image: ImageSettings::default(),
            run: RunSettings::default(),
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
            // Parts are for a rank's own threads: each makes them of the scene that it gets.
            Accel::Brute | Accel::Divided(_) => Ok(()),
            Accel::Bvh(wide) => {
                share.value(&mut wide.low)?;
                share.value(&mut wide.high)?;
                share.value(&mut wide.tree.stack_size)?;
                share.array(&mut wide.tree.nodes)?;
                share.array(&mut wide.tree.blocks)
            }
            Accel::Spheres(spheres) => {
                share.value(&mut spheres.extent)?;
                share.array(&mut spheres.objects)?;
                share.array(&mut spheres.blocks)
            }
            Accel::Grid(grid) => {
                share.value(&mut grid.low)?;
                share.value(&mut grid.size)?;
                share.value(&mut grid.counts)?;
                share.value(&mut grid.extent)?;
                share.array(&mut grid.starts)?;
                share.array(&mut grid.primitives)?;
                share.array(&mut grid.occupied)
            }
        }
    }
}

fn share_scene(scene: &mut Scene, share: Share) -> Result<()> {
    share.value(&mut scene.header)?;
    let surfaces = &mut scene.surfaces;
    share.array(&mut surfaces.positions)?;
    share.array(&mut surfaces.triangles)?;
    share.array(&mut surfaces.spheres)?;
    share.array(&mut surfaces.objects)?;
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

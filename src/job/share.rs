//! What every rank holds in the replicated splits, and its way there from rank 0.

use super::partition::Division;
use crate::accel::Accel;
use crate::cluster::share::Share;
use crate::error::Result;
use crate::scene::load::helio;
use crate::scene::{Scene, Texture};
use crate::settings::{ImageSettings, Integrator, RunSettings};

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
        if self.image.integrator == Integrator::Path {
            self.scene.prepare_lighting(None);
        }
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
                share.value(&mut grid.lattice)?;
                share.array(&mut grid.starts)?;
                share.array(&mut grid.primitives)?;
                share.array(&mut grid.occupied)
            }
        }
    }
}

fn share_scene(scene: &mut Scene, share: Share) -> Result<()> {
    // A scene that is in a file needn't be sent where that is.
    if !share_file(scene, share)? {
        share_arrays(scene, share)?;
    }
    // Rank 0 may have fitted the camera to the image, and has looked for emitters.
    share.value(&mut scene.header)
}

/// Where rank 0's scene is in a converted file: all ranks map the same one, if each of them has it. Whether they did.
///
/// Rank 0 has read it all; the others trust that what has the same checksum in its table is the same.
pub(super) fn share_file(scene: &mut Scene, share: Share) -> Result<bool> {
    let path = |scene: &Scene| {
        let file = scene.file.as_ref()?;
        let path = std::path::absolute(file.path()).ok()?;
        Some((path.to_str()?.to_owned(), file.checksum()))
    };
    let own = path(scene);
    let mut told = own.clone();
    share.value(&mut told)?;
    let Some((path, checksum)) = &told else { return Ok(false) };
    if own == told {
        return share.all(true);
    }
    let opened = helio::open(path.as_ref()).ok().map(|loaded| loaded.scene);
    let opened = opened.filter(|scene| scene.file.as_ref().is_some_and(|file| file.checksum() == *checksum));
    let all = share.all(opened.is_some())?;
    if let (true, Some(opened)) = (all, opened) {
        *scene = opened;
    }
    Ok(all)
}

fn share_arrays(scene: &mut Scene, share: Share) -> Result<()> {
    scene.file = None;
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

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;
    use crate::cluster::Comm;
    use crate::cluster::comm::memory;
    use crate::scene::helio::HelioWriter;
    use crate::scene::load;

    /// Writes a scene of so many spheres.
    fn convert(folder: &Path, depth: u32) -> Scene {
        let text = format!("[[object]]\ntype = 'sphereflake'\ndepth = {depth}\n[[object]]\ntype = 'box'");
        fs::write(folder.join("a.toml"), text).unwrap();
        let loaded = load::load(&folder.join("a.toml")).unwrap();
        let new = folder.join("new");
        let mut writer = HelioWriter::new(fs::File::create(&new).unwrap()).unwrap();
        helio::write(&mut writer, &loaded).unwrap();
        writer.finish().unwrap();
        fs::rename(new, folder.join("a.helio")).unwrap();
        load::load(&folder.join("a.helio")).unwrap().scene
    }

    /// Shares a scene among three ranks; whether they have mapped it, all alike.
    fn shared(scene: &Scene) -> bool {
        let mut scene = scene.clone();
        scene.header.camera.right *= 2.0;
        let scene = &scene;
        let mapped: Vec<bool> = std::thread::scope(|scope| {
            let ranks: Vec<_> = memory::group(3)
                .into_iter()
                .map(|comm| {
                    scope.spawn(move || {
                        let share = Share::new(&comm);
                        let mut own = if comm.rank() == 0 { scene.clone() } else { Scene::default() };
                        share_scene(&mut own, share).unwrap();
                        assert_eq!(own.surfaces.spheres, scene.surfaces.spheres);
                        assert_eq!(own.surfaces.triangles, scene.surfaces.triangles);
                        assert_eq!(own.header.camera, scene.header.camera);
                        assert_eq!(own.file.is_some(), own.surfaces.triangles.is_mapped());
                        own.file.is_some()
                    })
                })
                .collect();
            ranks.into_iter().map(|rank| rank.join().unwrap()).collect()
        });
        assert!(mapped.iter().all(|rank| *rank == mapped[0]), "{mapped:?}");
        mapped[0]
    }

    #[test]
    fn a_converted_scene_is_mapped_by_all_ranks_or_by_none() {
        let folder = tempfile::tempdir().unwrap();
        let scene = convert(folder.path(), 2);
        assert!(shared(&scene));
        // Another scene has taken its name meanwhile.
        let other = convert(folder.path(), 1);
        assert!(shared(&other) && !shared(&scene));
        fs::remove_file(folder.path().join("a.helio")).unwrap();
        assert!(!shared(&scene));
        let read = load::load(&folder.path().join("a.toml")).unwrap().scene;
        assert!(!shared(&read));
    }
}

"""Meshes a saved map for trimesh (pip install trimesh), and says how large it is. Open3D takes the same arrays.

python mesh_to_trimesh.py map.itm
"""

import sys

import itm_slam
import trimesh


def main(path: str) -> None:
    mesh = itm_slam.Session.resume(path).mesh()
    surface = trimesh.Trimesh(
        mesh.vertices, mesh.faces, vertex_normals=mesh.normals, vertex_colors=mesh.colours, process=False
    )
    # With Open3D:
    #   surface = open3d.geometry.TriangleMesh(
    #       open3d.utility.Vector3dVector(mesh.vertices), open3d.utility.Vector3iVector(mesh.faces.astype("int32")))
    #   surface.vertex_colors = open3d.utility.Vector3dVector(mesh.colours / 255)
    width, height, depth = surface.extents
    print(f"{len(surface.faces)} faces, {surface.area:.2f} m², {width:.2f} x {height:.2f} x {depth:.2f} m")


if __name__ == "__main__":
    main(*sys.argv[1:])

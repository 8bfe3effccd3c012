"""A way through a finished map: the grid as an array, shortest paths over its free cells, metres out again."""

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

import mapweave

made = mapweave.map(mapweave.simulate_laser(world=mapweave.OfficeConfig(rooms=2, visited=2), seed=1).log).maps[0]
grid = made.grid

# 0 free, 100 occupied, -1 unknown, row 0 lowest in y. A robot of 0.2 m radius keeps so far off walls.
cells = grid.to_numpy()
near_walls = binary_dilation(cells == 100, iterations=round(0.2 / grid.resolution))
free = (cells == 0) & ~near_walls
number = np.full(free.shape, -1)
number[free] = np.arange(free.sum())

# Neighbours in both directions are one step apart.
pairs = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:])]
a, b = (np.concatenate([pair[k].ravel() for pair in pairs]) for k in (0, 1))
both = (a >= 0) & (b >= 0)
graph = coo_array((np.full(both.sum(), grid.resolution), (a[both], b[both])), (free.sum(), free.sum())).tocsr()

# From where the robot began to where it was farthest from there, by the cells nearest to both.
centres = grid.origin + grid.resolution * (np.argwhere(free)[:, ::-1] + 0.5)
way = made.track.pose[:, :2]
far = way[np.argmax(np.hypot(*(way - way[0]).T))]
start, goal = (int(np.argmin(np.hypot(*(centres - place).T))) for place in (way[0], far))
[distance], [before] = dijkstra(graph, directed=False, indices=[start], return_predecessors=True)
path = [goal]
while path[-1] != start:
    path.append(int(before[path[-1]]))
print(
    f"a path of {len(path)} cells, {distance[goal]:.1f} m along the axes; it ends at {centres[goal].round(1).tolist()}"
)

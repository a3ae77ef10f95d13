"""The hard cases that this project set out with, and the tests that cover each: a table of docs/correctness.md.

A test is ``file::function`` without ``test_`` in front of either; a hard case (``rtrace/checks/hard_cases.py``) is in quotes.
"""

# ruff: noqa: E501

from typing import NamedTuple


class Entry(NamedTuple):
    """One entry of the list: its name, what it asks for, the tests and hard cases that cover it."""

    name: str
    what: str
    covered_by: tuple[str, ...]


EQUAL_TO_BRUTE = "hard_cases::nothing_is_lost_invented_or_unlike_brute_force"
BYTES = "render::bytes_do_not_depend_on_threads_or_repetition"

OPEN_LIST = [
    Entry("D1", "empty mesh, one triangle, nothing but degenerate triangles",
          ("scene::triangles_that_make_no_scene_are_refused", "scene::what_is_no_mesh_gets_one_sentence", '"one triangle"',
           '"only triangles without area"')),
    Entry("D2", "closed ball from inside, at vertices and edges",
          ("traverse::no_leaks_through_vertices_and_edges", '"ball from inside, at vertices and edges"',
           '"large ball from inside, at vertices and edges"')),
    Entry("D3", "the same far away, tiny and huge",
          ('"ball from inside, 10000 extents away"', '"ball from inside, 1e+06 extents away"', '"ball from inside, radius 1e-12"',
           '"ball from inside, radius 1e+12"')),
    Entry("D4", "scales of 1e-30 and 1e20", ('"ball from inside, radius 1e-30"', '"ball from inside, radius 1e+30"',
                                             "metamorphic::units")),
    Entry("D5", "height field of whole numbers, axis-parallel rays on its grid lines, zeros of both signs",
          ('"height field, rays on grid lines"', '"lattice soup, zeros of both signs"', "kdtree::both_zeros_are_one_position")),
    Entry("D6", "rays in split planes: BVH, kd-tree and brute force bitwise equal",
          ("traverse::rays_in_the_planes_of_boxes_equal_brute_force", "traverse::visits_and_hits_on_a_lattice", EQUAL_TO_BRUTE)),
    Entry("D7", "a ray along a face of a box, a ray in a triangle's plane",
          ('"boxes, rays in face planes and on edges"', '"rays in the planes of triangles, past and through them"')),
    Entry("D8", "origin on a split plane, on a face of a box, inside a leaf",
          ('"origins on faces, edges and vertices"', '"origins a hair off a surface"', "traverse::visits_and_hits_on_a_lattice")),
    Entry("D9", "direction zero, NaN, infinite, not of unit length; t_min above t_max",
          ("traverse::bad_rays_are_refused", "metamorphic::the_length_of_a_direction",
           "metamorphic::an_interval_that_ends_before_it_begins_holds_nothing", '"t_min above t_max"')),
    Entry("D10", "directions of length 1e-20 and 1e20",
          ("metamorphic::a_direction_of_any_size_hits_the_same", '"directions of length 1e-30 to 1e30"',
           '"directions with subnormal components"')),
    Entry("D11", "copies, two and a thousand, and reversed: of bitwise equal t the lowest number",
          ("metamorphic::copies_and_far_company", "kdtree::copies_are_left_in_one_leaf_but_heaps_of_them_are_parted",
           '"copies: a thousand, some of them reversed"', '"copies: a hundred thousand"')),
    Entry("D12", "coplanar triangles that overlap: the same in every tree, of bitwise equal t the lowest number",
          ("traverse::the_lowest_number_wins_among_equal_hits", "metamorphic::the_order_of_the_triangles",
           "ties::rounding_may_decide_between_triangles_in_one_plane", '"overlapping triangles in two planes"')),
    Entry("D13", "slivers, t within its bound", ('"slivers, a hundred thousand times as long as wide and more"',
                                                 '"triangles almost edge-on"',
                                                 '"slivers as wide as cos(pi/2) at the end of a floor"')),
    Entry("D14", "NaN and infinite vertices, numbers out of range and negative: dropped and counted",
          ("scene::bad_numbers_are_dropped_named_or_refused",
           "scene::vertices_that_are_no_numbers_are_dropped_and_unused_ones_never_matter",
           "nptrace::bad_triangles_are_dropped_with_a_warning_or_refused",
           "fuzz::any_input_is_accepted_or_refused_in_one_sentence")),
    Entry("D15", "equal centroids, a fan, a diagonal bundle: building ends, depth and memory stay bounded",
          ("kdtree::hard_inputs_end_within_their_limits", "bvh::hard_inputs_end",
           "merge_sort::a_stack_numbered_backwards_is_one_sorted_leaf", '"triangles with one centre"', '"needles along a diagonal"',
           '"many triangles that share a vertex"', "builders::a_floor_that_ends_a_hair_before_its_cell_is_built_in_few_levels")),
    Entry("D16", "stack depth from the tree, not a fixed array",
          ("hard_cases::the_stack_is_filled_to_its_last_entry", '"a triangle at every power of two"',
           "builders::trees_deeper_than_64_find_what_brute_force_finds")),
    Entry("D17", "every hit of every triangle lies in a leaf that lists it",
          ("metamorphic::every_hit_lies_in_a_leaf_that_lists_its_triangle", "kdtree::leaves_list_what_an_exact_clip_finds",
           "builders::leaves_list_exactly_what_reaches_into_them", "benchmark_scenes::leaves_list_the_triangles_that_reach_into_them",
           "benchmark_scenes::points_of_triangles_lie_in_leaves_that_list_them")),
    Entry("D18", "shadow rays: no acne and no leak at any scale",
          ("render::a_sphere_has_no_acne_and_no_leaks", '"shadows: ball, scale 1e-12"', '"shadows: ball, scale 1e+12"',
           '"shadows: light in a corner"')),
    Entry("D19", "an any-hit ray hits if there is a nearest hit", ("metamorphic::any_hit_is_whether_there_is_a_nearest_hit",)),
    Entry("D20", "any number of threads: the same bytes, accesses included",
          (BYTES, "replay::together_or_alone_and_with_any_number_of_threads",
           "sweep::batches_and_threads_make_no_difference")),
    Entry("D21", "units, axes, mirrors, order of the triangles",
          ("metamorphic::units", "metamorphic::axes_and_mirrors", "metamorphic::the_order_of_the_triangles",
           "kdtree::a_power_of_two_scales_the_tree")),
    Entry("D22", "agreement with Embree", ("embree::trees_agree_with_embree_on_the_scenes", "embree::trees_agree_with_embree_on_small_shapes")),
    Entry("D23", "a mesh of any bits: no crash, no hang",
          ("metamorphic::a_mesh_of_any_bits_is_traced_or_refused", "fuzz::any_input_is_accepted_or_refused_in_one_sentence")),
    Entry("D24", "caches on streams with known answers, inclusion of LRU, stack distances",
          ("replay::every_count_is_that_of_the_model", "replay::more_ways_never_miss_more",
           "sweep::distances_are_those_of_a_list", "dinero_golden::every_printed_counter")),
    Entry("D25", "with and without the filter: the same counts", ("sweep::the_filter_changes_no_count",)),
    Entry("D26", "the interval of an estimate covers the truth",
          ("estimate::a_small_calibration", "two_phase::intervals_hold_as_often_as_they_say",
           "cold_start::certain_and_open_misses_bracket_the_truth")),
]  # fmt: skip

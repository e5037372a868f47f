/* Small pictures of the orbit around a scene. */

#ifndef GS3_TESTS_ORBIT_H
#define GS3_TESTS_ORBIT_H

#include "check.h"

enum { WIDTH = 64, HEIGHT = 48, ORBIT = 240 };

static gs3_camera orbit_camera(const gs3_scene *scene, uint32_t frame) {
    gs3_camera camera = {.struct_size = sizeof camera};
    CHECK(gs3_camera_orbit(scene, frame, ORBIT, WIDTH, HEIGHT, &camera) == GS3_OK);
    return camera;
}

#endif

/* What the library logs, counted. */

#ifndef GS3_TESTS_LOGGED_H
#define GS3_TESTS_LOGGED_H

#include "check.h"

static int errors_logged = 0;
static int others_logged = 0;
static char last_logged[512];

static void on_log(gs3_log_level level, const char *message, void *user) {
    CHECK(user == (void *)last_logged);
    if (level == GS3_LOG_ERROR) {
        errors_logged++;
        snprintf(last_logged, sizeof last_logged, "%s", message);
    } else {
        others_logged++;
    }
}

#endif

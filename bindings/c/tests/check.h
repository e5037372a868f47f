/* Checks that count themselves, for the programs of this folder. */

#ifndef GS3_TESTS_CHECK_H
#define GS3_TESTS_CHECK_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <gs3.h>

static int checks_passed = 0;

/* Ends the program if something does not hold. */
#define CHECK(holds) \
    do { \
        if (!(holds)) { \
            fprintf(stderr, "%s:%d: expected %s (last error: %s)\n", __FILE__, __LINE__, #holds, \
                    gs3_last_error()); \
            exit(1); \
        } \
        checks_passed++; \
    } while (0)

/* Checks that a call fails with a status and a text that has the words. */
#define CHECK_FAILS(call, status, words) \
    do { \
        CHECK((call) == (status)); \
        CHECK(strstr(gs3_last_error(), (words)) != NULL); \
    } while (0)

/* Tells how many checks passed: the last thing that a program does. */
static inline int checks_end(void) {
    printf("%d checks passed\n", checks_passed);
    return 0;
}

#endif

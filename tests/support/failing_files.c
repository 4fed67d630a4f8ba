/* A file system that fails: preloaded, it lets the n-th call that changes something below a folder fail.
 *
 * FAIL_BELOW: the folder; FAIL_AT: which call (1, 2, ...), 0 for none; FAIL_WITH: the errno;
 * FAIL_ON: "" for every kind of call from then on (a full disk stays full), "once" for that one alone;
 * FAIL_COUNT: a file outside the folder to which every counted call appends a byte.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

#define REAL(name) __typeof__(&name) real = (__typeof__(&name))dlsym(RTLD_NEXT, #name)

static int below(const char *path)
{
    const char *folder = getenv("FAIL_BELOW");
    char whole[PATH_MAX];
    if (!folder || !path)
        return 0;
    if (path[0] != '/') {
        if (!getcwd(whole, sizeof whole - 1) || strlen(whole) + strlen(path) + 2 > sizeof whole)
            return 0;
        strcat(strcat(whole, "/"), path);
        path = whole;
    }
    return strncmp(path, folder, strlen(folder)) == 0;
}

static int open_below(int descriptor)
{
    char link[64], path[PATH_MAX];
    snprintf(link, sizeof link, "/proc/self/fd/%d", descriptor);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n < 0)
        return 0;
    path[n] = 0;
    return below(path);
}

/* The calls of all processes of the command are counted together: the length of a file is the count. */
static int fails(void)
{
    const char *at = getenv("FAIL_AT"), *count = getenv("FAIL_COUNT"), *with = getenv("FAIL_WITH");
    const char *on = getenv("FAIL_ON");
    if (!at || !count || !with)
        return 0;
    int descriptor = (int)((__typeof__(&open))dlsym(RTLD_NEXT, "open"))(count, O_WRONLY | O_CREAT | O_APPEND, 0600);
    if (descriptor < 0)
        return 0;
    ((__typeof__(&write))dlsym(RTLD_NEXT, "write"))(descriptor, ".", 1);
    long n = (long)lseek(descriptor, 0, SEEK_CUR);
    close(descriptor);
    long due = atol(at);
    int once = on && strcmp(on, "once") == 0;
    if (due > 0 && (once ? n == due : n >= due)) {
        errno = atoi(with);
        return 1;
    }
    return 0;
}

static int changes(int flags)
{
    return (flags & O_ACCMODE) != O_RDONLY && (flags & (O_CREAT | O_TRUNC));
}

#define OPENS(name)                                       \
    int name(const char *path, int flags, ...)            \
    {                                                     \
        REAL(name);                                       \
        va_list rest;                                     \
        va_start(rest, flags);                            \
        mode_t mode = flags & O_CREAT ? va_arg(rest, int) : 0; \
        va_end(rest);                                     \
        if (changes(flags) && below(path) && fails())     \
            return -1;                                    \
        return real(path, flags, mode);                   \
    }
OPENS(open)
OPENS(open64)

#define OPENS_AT(name)                                    \
    int name(int folder, const char *path, int flags, ...) \
    {                                                     \
        REAL(name);                                       \
        va_list rest;                                     \
        va_start(rest, flags);                            \
        mode_t mode = flags & O_CREAT ? va_arg(rest, int) : 0; \
        va_end(rest);                                     \
        if (changes(flags) && below(path) && fails())     \
            return -1;                                    \
        return real(folder, path, flags, mode);           \
    }
OPENS_AT(openat)
OPENS_AT(openat64)

#define OPENS_FILE(name)                                  \
    FILE *name(const char *path, const char *mode)        \
    {                                                     \
        REAL(name);                                       \
        if (mode[0] != 'r' && below(path) && fails())     \
            return NULL;                                  \
        return real(path, mode);                          \
    }
OPENS_FILE(fopen)
OPENS_FILE(fopen64)

ssize_t write(int descriptor, const void *bytes, size_t n)
{
    REAL(write);
    if (open_below(descriptor) && fails())
        return -1;
    return real(descriptor, bytes, n);
}

#define WRITES_AT(name, offset_t)                         \
    ssize_t name(int descriptor, const void *bytes, size_t n, offset_t offset) \
    {                                                     \
        REAL(name);                                       \
        if (open_below(descriptor) && fails())            \
            return -1;                                    \
        return real(descriptor, bytes, n, offset);        \
    }
WRITES_AT(pwrite, off_t)
WRITES_AT(pwrite64, off64_t)

int fsync(int descriptor)
{
    REAL(fsync);
    if (open_below(descriptor) && fails())
        return -1;
    return real(descriptor);
}

int mkdir(const char *path, mode_t mode)
{
    REAL(mkdir);
    if (below(path) && fails())
        return -1;
    return real(path, mode);
}

int rename(const char *from, const char *to)
{
    REAL(rename);
    if (below(to) && fails())
        return -1;
    return real(from, to);
}

/* Preloaded into the program: a disk that is full after some bytes, and a log of what is synced and renamed. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

static long long left_bytes(long long taken) {
    static long long left = -2;
    if (left == -2) {
        const char *limit = getenv("OSTEOFLOW_TEST_DISK_BYTES");
        left = limit ? atoll(limit) : -1;
    }
    if (left >= 0) left = left < taken ? 0 : left - taken;
    return left;
}

/* Regular files but the log. */
static int is_file(int fd) {
    struct stat found;
    return fstat(fd, &found) == 0 && S_ISREG(found.st_mode);
}

static int is_full(int fd, size_t n) {
    if (getenv("OSTEOFLOW_TEST_DISK_BYTES") == NULL || !is_file(fd)) return 0;
    if (left_bytes(0) < (long long)n) {
        left_bytes(n);
        errno = ENOSPC;
        return 1;
    }
    left_bytes(n);
    return 0;
}

static void note(const char *what, const char *path) {
    const char *log = getenv("OSTEOFLOW_TEST_DISK_LOG");
    if (log == NULL) return;
    char line[4096];
    int n = snprintf(line, sizeof line, "%s %s\n", what, path);
    int fd = open(log, O_WRONLY | O_APPEND | O_CREAT, 0600);
    ssize_t (*real)(int, const void *, size_t) = dlsym(RTLD_NEXT, "write");
    if (fd >= 0 && n > 0) real(fd, line, (size_t)n);
    if (fd >= 0) close(fd);
}

static void note_fd(const char *what, int fd) {
    char link[64], path[2048];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    path[n > 0 ? n : 0] = 0;
    note(what, path);
}

ssize_t write(int fd, const void *bytes, size_t n) {
    ssize_t (*real)(int, const void *, size_t) = dlsym(RTLD_NEXT, "write");
    return is_full(fd, n) ? -1 : real(fd, bytes, n);
}

ssize_t writev(int fd, const struct iovec *slices, int n) {
    ssize_t (*real)(int, const struct iovec *, int) = dlsym(RTLD_NEXT, "writev");
    size_t all = 0;
    for (int i = 0; i < n; i++) all += slices[i].iov_len;
    return is_full(fd, all) ? -1 : real(fd, slices, n);
}

int fsync(int fd) {
    int (*real)(int) = dlsym(RTLD_NEXT, "fsync");
    note_fd("fsync", fd);
    if (getenv("OSTEOFLOW_TEST_SYNC_WAITS") != NULL && is_file(fd))
        for (;;) pause();
    if (getenv("OSTEOFLOW_TEST_SYNC_FAILS") != NULL && is_file(fd)) {
        errno = EIO;
        return -1;
    }
    return real(fd);
}

int rename(const char *from, const char *to) {
    int (*real)(const char *, const char *) = dlsym(RTLD_NEXT, "rename");
    note("rename", to);
    return real(from, to);
}

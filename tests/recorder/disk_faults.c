/* A disk that fails on demand, for the recorder under test (LD_PRELOAD).
 *
 * DISK_FAULTS_FOLDER: paths below it are on that disk. DISK_FAULTS_MODE: a file with one word:
 *   ok, full (ENOSPC; a write takes a part first), failing (EIO), readonly (EROFS),
 *   stalled (a call comes back when the word changes).
 * Each fdatasync that succeeds appends a line "sync NANOSECONDS" to DISK_FAULTS_LOG.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

static char mode(void) {
    char word[16] = "o";
    const char *path = getenv("DISK_FAULTS_MODE");
    int file = path ? (int)syscall(SYS_openat, AT_FDCWD, path, O_RDONLY) : -1;
    if (file >= 0) {
        if (syscall(SYS_read, file, word, sizeof word - 1) <= 0)
            word[0] = 'o';
        syscall(SYS_close, file);
    }
    return word[0] == 'f' && word[1] == 'a' ? 'e' : word[0];
}

static int below(const char *path) {
    const char *folder = getenv("DISK_FAULTS_FOLDER");
    return folder && path && strncmp(path, folder, strlen(folder)) == 0;
}

static int on_disk(int file) {
    char name[64], path[4096];
    snprintf(name, sizeof name, "/proc/self/fd/%d", file);
    ssize_t size = readlink(name, path, sizeof path - 1);
    if (size < 0)
        return 0;
    path[size] = 0;
    return below(path);
}

/* The error that a call gets, 0 for none, once the disk no longer stalls. */
static int fault(void) {
    char now = mode();
    while (now == 's') {
        struct timespec pause = {0, 10 * 1000 * 1000};
        nanosleep(&pause, NULL);
        now = mode();
    }
    return now == 'f' ? ENOSPC : now == 'e' ? EIO : now == 'r' ? EROFS : 0;
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

ssize_t write(int file, const void *data, size_t size) {
    if (!on_disk(file))
        return REAL(write)(file, data, size);
    int error = fault();
    static int took_a_part;
    if (error == ENOSPC && (took_a_part = !took_a_part) && size > 64)
        return REAL(write)(file, data, 64);
    if (error) {
        errno = error;
        return -1;
    }
    return REAL(write)(file, data, size);
}

static int synced(int file, int (*real)(int)) {
    if (!on_disk(file))
        return real(file);
    int error = fault();
    if (error && error != ENOSPC) {
        errno = error;
        return -1;
    }
    int done = real(file);
    const char *log = getenv("DISK_FAULTS_LOG");
    if (log && done == 0) {
        struct timespec now;
        char line[64];
        clock_gettime(CLOCK_MONOTONIC, &now);
        int size = snprintf(line, sizeof line, "sync %lld\n",
                            (long long)now.tv_sec * 1000000000LL + now.tv_nsec);
        int out = (int)syscall(SYS_openat, AT_FDCWD, log, O_WRONLY | O_CREAT | O_APPEND, 0644);
        syscall(SYS_write, out, line, size);
        syscall(SYS_close, out);
    }
    return done;
}

int fdatasync(int file) { return synced(file, REAL(fdatasync)); }

static int opened(int (*real)(const char *, int, ...), const char *path, int flags, int rights) {
    int error = (flags & O_CREAT) && below(path) ? fault() : 0;
    if (error) {
        errno = error;
        return -1;
    }
    return real(path, flags, rights);
}

int open(const char *path, int flags, ...) {
    va_list more;
    va_start(more, flags);
    int rights = va_arg(more, int);
    va_end(more);
    return opened(REAL(open), path, flags, rights);
}

int open64(const char *path, int flags, ...) {
    va_list more;
    va_start(more, flags);
    int rights = va_arg(more, int);
    va_end(more);
    return opened(REAL(open64), path, flags, rights);
}

int mkdir(const char *path, mode_t rights) {
    int error = below(path) ? fault() : 0;
    if (error) {
        errno = error;
        return -1;
    }
    return REAL(mkdir)(path, rights);
}

// The half of a gateway that faces the service: uploads the batches of a spool until the service has stored them.
#pragma once

#include <curl/curl.h>
#include <openssl/evp.h>
#include <zlib.h>

#include <chrono>
#include <cmath>
#include <cstdlib>
#include <optional>
#include <random>

#include "spool.hpp"

inline std::string gzip(const std::string &plain) {
    z_stream stream{};
    if (deflateInit2(&stream, Z_DEFAULT_COMPRESSION, Z_DEFLATED, 15 + 16, 8, Z_DEFAULT_STRATEGY) != Z_OK)
        throw std::bad_alloc();
    std::string packed(deflateBound(&stream, plain.size()), '\0');
    stream.next_in = reinterpret_cast<Bytef *>(const_cast<char *>(plain.data()));
    stream.avail_in = plain.size();
    stream.next_out = reinterpret_cast<Bytef *>(packed.data());
    stream.avail_out = packed.size();
    deflate(&stream, Z_FINISH);
    packed.resize(stream.total_out);
    deflateEnd(&stream);
    return packed;
}

inline std::string content_digest(const std::string &bytes) {
    unsigned char digest[EVP_MAX_MD_SIZE], text[2 * EVP_MAX_MD_SIZE];
    unsigned int length = 0;
    EVP_Digest(bytes.data(), bytes.size(), digest, &length, EVP_sha256(), nullptr);
    EVP_EncodeBlock(text, digest, static_cast<int>(length));
    return "Content-Digest: sha-256=:" + std::string(reinterpret_cast<char *>(text)) + ":";
}

/// Without the white space that a file of secrets may have at its end.
inline std::string key_in_environment() {
    const char *stated = std::getenv("MAPSHIFT_KEY");
    std::string key = stated ? stated : "";
    key.erase(key.find_last_not_of(" \t\r\n") + 1);
    return key;
}

struct Answer {
    long status = 0;  // 0 if none came whole
    std::string text;
    std::optional<double> retry_after_s;

    bool is_stored() const { return status == 200 || status == 202; }
    bool is_refusal() const {  // a digest that does not match is worth a repeat: other bytes arrived than were sent
        const bool damaged = text.find("/problems/digest-mismatch") != std::string::npos;
        return status >= 400 && status < 500 && status != 408 && status != 429 && !damaged;
    }
};

/// Uploads one batch after the other, in a thread of its own, until the service has stored them.
class Uploader {
  public:
    /// `url` is that of a route's batches: …/v1/routes/{route}/batches.
    Uploader(std::string url, fs::path spool, double timeout_s, double first_wait_s)
        : url_(std::move(url)), spool_(std::move(spool)), timeout_s_(timeout_s), first_wait_s_(first_wait_s),
          thread_([this] { run(); }) {}

    ~Uploader() {
        {
            std::lock_guard lock(mutex_);
            stop_ = true;
        }
        stopped_.notify_all();
        thread_.join();
    }

  private:
    void run() {
        int failures = 0;
        while (true) {
            const Answer answer = attempt_next();
            if (pause(0)) return;
            if (answer.is_stored() || answer.is_refusal()) {
                failures = 0;
            } else {
                const double wait_s = this->wait_s(failures++, answer.retry_after_s);
                std::cerr << answer.status << " " << answer.text.substr(0, 200) << "; again in " << wait_s << " s\n";
                pause(wait_s);
            }
        }
    }

    Answer attempt_next() try {
        while (true) {
            const auto batches = files(spool_, ".scans");
            if (!batches.empty()) return attempt(batches.front());
            if (pause(0.2)) return {};
        }
    } catch (const std::exception &error) {  // a full disk, a lost mount, what cannot be foreseen: the thread goes on
        return {0, error.what(), {}};
    }

    Answer attempt(const fs::path &batch) {
        const std::string name = batch.stem();
        Answer answer = put(url_ + "/" + name, gzip(body_of(batch)));
        if (answer.is_stored()) {
            fs::rename(batch, spool_ / "last-stored");  // forgotten, but for where its trip goes on
        } else if (answer.is_refusal()) {
            std::cerr << name << " was refused: " << answer.status << " " << answer.text << "\n";
            std::ofstream(spool_ / "refused" / (name + ".problem.json")) << answer.text;
            fs::rename(batch, spool_ / "refused" / batch.filename());
        } else {
            answer.text = name + ": " + answer.text;
        }
        return answer;
    }

    Answer put(const std::string &url, const std::string &body) {
        Answer answer;
        CURL *curl = curl_easy_init();
        curl_slist *headers = nullptr;
        for (const std::string &header : {std::string("Content-Type: application/json"),
                                          std::string("Content-Encoding: gzip"), std::string("Expect:"), content_digest(body)})
            headers = curl_slist_append(headers, header.c_str());
        if (const std::string key = key_in_environment(); !key.empty())
            headers = curl_slist_append(headers, ("Authorization: Bearer " + key).c_str());
        curl_easy_setopt(curl, CURLOPT_URL, url.c_str());
        curl_easy_setopt(curl, CURLOPT_CUSTOMREQUEST, "PUT");
        curl_easy_setopt(curl, CURLOPT_POSTFIELDS, body.data());
        curl_easy_setopt(curl, CURLOPT_POSTFIELDSIZE_LARGE, static_cast<curl_off_t>(body.size()));
        curl_easy_setopt(curl, CURLOPT_HTTPHEADER, headers);
        curl_easy_setopt(curl, CURLOPT_NOSIGNAL, 1L);
        curl_easy_setopt(curl, CURLOPT_TIMEOUT_MS, static_cast<long>(timeout_s_ * 1000));
        curl_easy_setopt(curl, CURLOPT_WRITEDATA, &answer.text);
        curl_easy_setopt(curl, CURLOPT_WRITEFUNCTION, +[](char *bytes, size_t size, size_t count, void *text) {
            static_cast<std::string *>(text)->append(bytes, size * count);
            return size * count;
        });
        const CURLcode code = curl_easy_perform(curl);
        curl_off_t after_s = 0;
        if (code == CURLE_OK) {
            curl_easy_getinfo(curl, CURLINFO_RESPONSE_CODE, &answer.status);
            curl_easy_getinfo(curl, CURLINFO_RETRY_AFTER, &after_s);
            if (after_s > 0) answer.retry_after_s = after_s;
        } else {
            answer.text = curl_easy_strerror(code);
        }
        curl_slist_free_all(headers);
        curl_easy_cleanup(curl);
        return answer;
    }

    /// What the service states and up to a quarter more; else twice as long each time, of which half is random.
    double wait_s(int failures, std::optional<double> stated_s) {
        std::uniform_real_distribution<double> random(0, 1);
        if (stated_s) return *stated_s * (1 + 0.25 * random(random_));
        return std::min(300.0, first_wait_s_ * std::pow(2, failures)) * (0.5 + 0.5 * random(random_));
    }

    bool pause(double seconds) {  // whether the end has come
        std::unique_lock lock(mutex_);
        return stopped_.wait_for(lock, std::chrono::duration<double>(seconds), [this] { return stop_; });
    }

    const std::string url_;
    const fs::path spool_;
    const double timeout_s_, first_wait_s_;
    std::mt19937 random_{std::random_device{}()};
    std::mutex mutex_;
    std::condition_variable stopped_;
    bool stop_ = false;
    std::thread thread_;  // the last: it uses the others
};
